"""The task suite, written once against the core's interfaces. Names no engine."""

from __future__ import annotations

from typing import TYPE_CHECKING

from orbit_core.exports import lazy_names

if TYPE_CHECKING:
    from orbit_core.envs.registry import TaskRegistry
    from orbit_tasks.beat_the_buzz import BeatTheBuzz
    from orbit_tasks.cabinet import Cabinet
    from orbit_tasks.cartpole import CartpoleBalance, CartpoleSwingUp
    from orbit_tasks.cloth_dropping import ClothDropping
    from orbit_tasks.cloth_folding import ClothFolding
    from orbit_tasks.cloth_lifting import ClothLifting
    from orbit_tasks.cloth_spreading import ClothSpreading
    from orbit_tasks.dishwasher import Dishwasher
    from orbit_tasks.flag_hoisting import FlagHoisting
    from orbit_tasks.gentle_lift import GentleLift
    from orbit_tasks.handover import Handover
    from orbit_tasks.hockey import Hockey
    from orbit_tasks.in_hand_repose import InHandRepose
    from orbit_tasks.jenga import Jenga
    from orbit_tasks.lift import Lift
    from orbit_tasks.mobile_cabinet import MobileCabinet
    from orbit_tasks.mobile_lift import MobileLift
    from orbit_tasks.mobile_reach import MobileReach
    from orbit_tasks.nut_bolt import NutBolt
    from orbit_tasks.peg_in_hole import PegInHole
    from orbit_tasks.peg_in_the_dark import PegInTheDark
    from orbit_tasks.pick_and_place import PickAndPlace
    from orbit_tasks.reach import Reach
    from orbit_tasks.recover import Recover
    from orbit_tasks.room_reorganization import RoomReorganization
    from orbit_tasks.rope_reshaping import RopeReshaping
    from orbit_tasks.running import Ant, Humanoid
    from orbit_tasks.soft_dropping import SoftDropping
    from orbit_tasks.soft_grasp import SoftGrasp
    from orbit_tasks.soft_lifting import SoftLifting
    from orbit_tasks.soft_placing import SoftPlacing
    from orbit_tasks.soft_stacking import SoftStacking
    from orbit_tasks.stack_pyramid import Stack, StackPyramid
    from orbit_tasks.tower_of_hanoi import TowerOfHanoi
    from orbit_tasks.velocity_flat import VelocityFlat
    from orbit_tasks.velocity_rough import VelocityRough

__all__ = [
    "Ant",
    "BeatTheBuzz",
    "Cabinet",
    "CartpoleBalance",
    "CartpoleSwingUp",
    "ClothDropping",
    "ClothFolding",
    "ClothLifting",
    "ClothSpreading",
    "Dishwasher",
    "FlagHoisting",
    "GentleLift",
    "Handover",
    "Hockey",
    "Humanoid",
    "InHandRepose",
    "Jenga",
    "Lift",
    "MobileCabinet",
    "MobileLift",
    "MobileReach",
    "NutBolt",
    "PegInHole",
    "PegInTheDark",
    "PickAndPlace",
    "Reach",
    "Recover",
    "RoomReorganization",
    "RopeReshaping",
    "SoftDropping",
    "SoftGrasp",
    "SoftLifting",
    "SoftPlacing",
    "SoftStacking",
    "Stack",
    "StackPyramid",
    "TowerOfHanoi",
    "VelocityFlat",
    "VelocityRough",
    "register",
]

__getattr__, __dir__ = lazy_names(
    __name__,
    {
        "beat_the_buzz": ("BeatTheBuzz",),
        "cabinet": ("Cabinet",),
        "cartpole": (
            "CartpoleBalance",
            "CartpoleSwingUp",
        ),
        "cloth_dropping": ("ClothDropping",),
        "cloth_folding": ("ClothFolding",),
        "cloth_lifting": ("ClothLifting",),
        "cloth_spreading": ("ClothSpreading",),
        "dishwasher": ("Dishwasher",),
        "flag_hoisting": ("FlagHoisting",),
        "gentle_lift": ("GentleLift",),
        "handover": ("Handover",),
        "hockey": ("Hockey",),
        "in_hand_repose": ("InHandRepose",),
        "jenga": ("Jenga",),
        "lift": ("Lift",),
        "mobile_cabinet": ("MobileCabinet",),
        "mobile_lift": ("MobileLift",),
        "mobile_reach": ("MobileReach",),
        "nut_bolt": ("NutBolt",),
        "peg_in_hole": ("PegInHole",),
        "peg_in_the_dark": ("PegInTheDark",),
        "pick_and_place": ("PickAndPlace",),
        "reach": ("Reach",),
        "recover": ("Recover",),
        "room_reorganization": ("RoomReorganization",),
        "rope_reshaping": ("RopeReshaping",),
        "running": (
            "Ant",
            "Humanoid",
        ),
        "soft_dropping": ("SoftDropping",),
        "soft_grasp": ("SoftGrasp",),
        "soft_lifting": ("SoftLifting",),
        "soft_placing": ("SoftPlacing",),
        "soft_stacking": ("SoftStacking",),
        "stack_pyramid": (
            "Stack",
            "StackPyramid",
        ),
        "tower_of_hanoi": ("TowerOfHanoi",),
        "velocity_flat": ("VelocityFlat",),
        "velocity_rough": ("VelocityRough",),
    },
)


def register(registry: TaskRegistry) -> None:
    """Entry point ``orbit.tasks``: register every task, importing none."""
    registry.add("Reach", "Bring the end effector to a sampled pose", "orbit_tasks.reach:Reach")
    registry.add("Lift", "Lift a cube from the table to a sampled position", "orbit_tasks.lift:Lift")
    registry.add(
        "Pick-And-Place", "Put a cube on a mark on the table's other half", "orbit_tasks.pick_and_place:PickAndPlace"
    )
    registry.add("Stack", "Put one block on another", "orbit_tasks.stack_pyramid:Stack")
    registry.add("Stack-Pyramid", "Build two pyramids of coloured blocks", "orbit_tasks.stack_pyramid:StackPyramid")
    registry.add("Hockey", "Hit a puck with a stick into the net", "orbit_tasks.hockey:Hockey")
    registry.add("Nut-Bolt", "Set a nut on a bolt and screw it down", "orbit_tasks.nut_bolt:NutBolt")
    registry.add("Jenga", "Pull a block out of a tower and put it on top", "orbit_tasks.jenga:Jenga")
    registry.add("Peg-In-Hole", "Put blocks into the holes that match them", "orbit_tasks.peg_in_hole:PegInHole")
    registry.add(
        "Peg-In-The-Dark", "Feel for a hole and put a block into it", "orbit_tasks.peg_in_the_dark:PegInTheDark"
    )
    registry.add(
        "Gentle-Lift",
        "Lift a box of unknown weight, gripped no tighter than needed",
        "orbit_tasks.gentle_lift:GentleLift",
    )
    registry.add(
        "Beat-The-Buzz", "Lead a ring along a bent rod without a touch", "orbit_tasks.beat_the_buzz:BeatTheBuzz"
    )
    registry.add("Cabinet", "Open a drawer by its handle to a given position", "orbit_tasks.cabinet:Cabinet")
    registry.add(
        "Dishwasher", "Pull a dishwasher's door off its seal, then its rack out", "orbit_tasks.dishwasher:Dishwasher"
    )
    registry.add(
        "Handover",
        "One arm passes a rod to another, which brings it to a sampled position",
        "orbit_tasks.handover:Handover",
    )
    registry.add(
        "Mobile-Reach",
        "Drive to a sampled pose and bring the end effector there",
        "orbit_tasks.mobile_reach:MobileReach",
    )
    registry.add("Mobile-Cabinet", "Drive to a cabinet and open its drawer", "orbit_tasks.mobile_cabinet:MobileCabinet")
    registry.add("Mobile-Lift", "Drive around a table to a cube and lift it", "orbit_tasks.mobile_lift:MobileLift")
    registry.add(
        "Room-Reorganization",
        "Bring several things to their places in a room",
        "orbit_tasks.room_reorganization:RoomReorganization",
    )
    registry.add(
        "Velocity-Flat",
        "A legged robot follows a commanded velocity on a plane",
        "orbit_tasks.velocity_flat:VelocityFlat",
    )
    registry.add(
        "Velocity-Rough",
        "A legged robot follows a commanded velocity on terrain that it sees",
        "orbit_tasks.velocity_rough:VelocityRough",
    )
    registry.add("Recover", "A legged robot stands up from wherever it lies", "orbit_tasks.recover:Recover")
    registry.add(
        "Cloth-Lifting", "Lift a cloth by its middle to a sampled position", "orbit_tasks.cloth_lifting:ClothLifting"
    )
    registry.add(
        "Rope-Reshaping", "Bend a rope into a corner of a sampled angle", "orbit_tasks.rope_reshaping:RopeReshaping"
    )
    registry.add(
        "Cloth-Dropping", "Drop a cloth into a container next to its tray", "orbit_tasks.cloth_dropping:ClothDropping"
    )
    registry.add(
        "Flag-Hoisting", "Raise a flag by its staff to its place at a mast", "orbit_tasks.flag_hoisting:FlagHoisting"
    )
    registry.add("Cloth-Spreading", "Spread a crumpled cloth on its tray", "orbit_tasks.cloth_spreading:ClothSpreading")
    registry.add(
        "Cloth-Folding", "Fold a cloth along its diagonal, corner on corner", "orbit_tasks.cloth_folding:ClothFolding"
    )
    registry.add(
        "Soft-Lifting", "Lift a soft block from the table to a sampled position", "orbit_tasks.soft_lifting:SoftLifting"
    )
    registry.add(
        "Fluid-Transport",
        "Carry a full cup to a sampled position without spilling",
        "orbit_tasks.fluid_transport:FluidTransport",
    )
    registry.add("Fluid-Pouring", "Pour liquid from a cup into a container", "orbit_tasks.fluid_pouring:FluidPouring")
    registry.add("Soft-Stacking", "Put one soft block on another", "orbit_tasks.soft_stacking:SoftStacking")
    registry.add(
        "Soft-Placing", "Put a soft block on a pad, turned as the pad is", "orbit_tasks.soft_placing:SoftPlacing"
    )
    registry.add("Soft-Dropping", "Drop a soft block into a container", "orbit_tasks.soft_dropping:SoftDropping")
    registry.add("Soft-Grasp", "Lift a fragile fruit with soft fingers", "orbit_tasks.soft_grasp:SoftGrasp")
    registry.add(
        "Tower-Of-Hanoi",
        "Put three soft rings round a rod, in decreasing size",
        "orbit_tasks.tower_of_hanoi:TowerOfHanoi",
    )
    registry.add("Cartpole-Balance", "Keep a pole standing on a cart", "orbit_tasks.cartpole:CartpoleBalance")
    registry.add("Cartpole-Swing-Up", "Swing a hanging pole up on a cart", "orbit_tasks.cartpole:CartpoleSwingUp")
    registry.add("Ant", "A robot of four legs runs as fast as it can", "orbit_tasks.running:Ant")
    registry.add("Humanoid", "A robot of two legs runs as fast as it can", "orbit_tasks.running:Humanoid")
    registry.add(
        "In-Hand-Repose",
        "Turn an object in a hand to one sampled orientation after another",
        "orbit_tasks.in_hand_repose:InHandRepose",
    )
