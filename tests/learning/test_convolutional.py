"""The network ``convolutional``: its file, its ONNX, what it refuses, and where its policies play."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
import torch
from torch import Tensor

from orbit_core.envs import Environment, ObservationGroup, ObservationTerm
from orbit_core.interfaces import ConfigurationError
from orbit_core.mdp.sensing import camera_color, camera_depth
from orbit_core.scene import CameraSpec, Channel
from orbit_learn.description import Part, PolicyDescription, group_parts
from orbit_learn.networks import ActorNetwork, Convolutional, Picture, PictureEncoder, convolutional
from orbit_learn.picture_layers import MeanPlaces
from orbit_learn.policy import Policy, PolicyNode, load_policy
from orbit_tasks.reach import Reach

PARTS = (
    Part("joints", 3),
    Part("hand_color", 9 * 8 * 3, (9, 8, 3), "uint8", 0.0, 255.0, "hand"),
    Part("hand_depth", 9 * 8, (9, 8, 1), "float32", 0.0, 2.0, "hand"),
    Part("front_color", 6 * 5 * 3, (6, 5, 3), "uint8", 0.0, 255.0, "front"),
)
DESCRIPTION = PolicyDescription(
    "A-Task", "a_robot", "joint_position", PARTS, (Part("moved", 2),), 0.02, "an_engine", "distill", 3,
    concatenated=False,
)  # fmt: skip


def policy() -> Policy:
    torch.manual_seed(0)
    network = convolutional(PARTS, (16,))
    module = network.build(0, 2).requires_grad_(False).eval()
    module.mean.copy_(torch.tensor([1.0, 0.0, -1.0]))
    module.std.copy_(torch.tensor([1.0, 2.0, 0.5]))
    return Policy(module, network, DESCRIPTION)


def observation(count: int) -> dict[str, Tensor]:
    torch.manual_seed(count)
    pictures = {part.name: torch.randint(0, 256, (count, *(part.shape or ()))).byte() for part in PARTS[1::2]}
    return {"joints": torch.randn(count, 3), "hand_depth": 3.0 * torch.rand(count, 9, 8, 1), **pictures}


def test_a_policy_its_file_and_its_onnx_act_alike(tmp_path: Path) -> None:
    """ONNX's inputs are the terms by name, as they are: uint8 colours with their channels last."""
    made = policy()
    made.save(tmp_path / "policy_3.safetensors")
    made.export_onnx(tmp_path / "policy.onnx")
    read = load_policy(tmp_path)
    assert read.description == DESCRIPTION
    assert read.network == made.network
    session = onnxruntime.InferenceSession(tmp_path / "policy.onnx")
    for count in (1, 5):
        seen = observation(count)
        expected = made.module(seen)
        assert torch.equal(read.module(seen), expected)
        (action,) = session.run(["action"], {name: value.numpy() for name, value in seen.items()})
        np.testing.assert_allclose(action, expected.numpy(), atol=1e-5)


def test_places_move_with_what_is_seen_and_act_alike_in_a_file_and_onnx(tmp_path: Path) -> None:
    """A mean place is known to a fraction of its cell."""
    maps = torch.zeros(3, 1, 5, 9)
    maps[0, 0, 1, 6] = maps[1, 0, 4, 0] = maps[2, 0, 2, 3] = maps[2, 0, 2, 4] = 50.0
    expected = torch.tensor([[-0.5, 0.5], [1.0, -1.0], [0.0, -0.125]])
    torch.testing.assert_close(MeanPlaces(5, 9)(maps), expected, atol=1e-5, rtol=0.0)
    made = policy()
    assert isinstance(made.network, Convolutional)
    encoders = tuple(replace(each, places=4) for each in made.network.encoders)
    network = replace(made.network, encoders=encoders)
    torch.manual_seed(0)
    seeing = Policy(network.build(0, 2).requires_grad_(False).eval(), network, DESCRIPTION)
    seeing.save(tmp_path / "policy_3.safetensors")
    seeing.export_onnx(tmp_path / "policy.onnx")
    seen = observation(3)
    expected = seeing.module(seen)
    torch.testing.assert_close(load_policy(tmp_path).module(seen), expected, atol=1e-6, rtol=0.0)
    session = onnxruntime.InferenceSession(tmp_path / "policy.onnx")
    (action,) = session.run(["action"], {name: value.numpy() for name, value in seen.items()})
    np.testing.assert_allclose(action, expected.numpy(), atol=1e-5)


def test_onnx_of_a_dictionary_is_not_read_back_and_says_what_is(tmp_path: Path) -> None:
    policy().export_onnx(tmp_path / "policy.onnx")
    with pytest.raises(ConfigurationError, match=r"4 inputs and 1 outputs.*dictionary of terms.*\.safetensors file"):
        load_policy(tmp_path / "policy.onnx")


def test_colour_and_depth_of_a_camera_are_one_picture() -> None:
    hand, front = convolutional(PARTS, (16,)).encoders
    assert [(picture.term, picture.far) for picture in hand.pictures] == [("hand_color", None), ("hand_depth", 2.0)]
    assert [picture.term for picture in front.pictures] == ["front_color"]


def test_depth_beyond_the_far_end_is_as_at_it() -> None:
    made, seen = policy(), observation(2)
    far = made.module({**seen, "hand_depth": torch.full((2, 9, 8, 1), 2.0)})
    assert torch.equal(made.module({**seen, "hand_depth": torch.full((2, 9, 8, 1), torch.inf)}), far)
    assert not torch.equal(made.module({**seen, "hand_depth": torch.full((2, 9, 8, 1), 1.0)}), far)


@pytest.mark.parametrize("far", [0.5, 10.0])
def test_depth_is_scaled_by_the_bounds_of_its_term(far: float) -> None:
    network = convolutional((replace(PARTS[2], high=far),), (16,))
    module = network.build(0, 2)
    seen = [module({"hand_depth": torch.full((1, 9, 8, 1), share * far)}) for share in (0.2, 0.3, 0.8, 1.0, 2.0)]
    assert all(not torch.equal(a, b) for a, b in pairwise(seen[:4])), "within the bounds all differ"
    assert torch.equal(seen[3], seen[4])


def test_pictures_form_one_input_by_their_camera_not_by_their_names() -> None:
    renamed = (replace(PARTS[1], name="what_is_seen"), replace(PARTS[2], name="how_far"))
    (both,) = convolutional(renamed, (16,)).encoders
    assert [picture.term for picture in both.pictures] == ["what_is_seen", "how_far"]
    strangers = (replace(PARTS[1], camera=None), replace(PARTS[2], camera=None))
    assert len(convolutional(strangers, (16,)).encoders) == 2


def test_terms_of_cameras_say_whose_picture_they_are_and_how_far_they_see() -> None:
    camera = CameraSpec(name="scan", width=4, height=4, far=7.0, channels=(Channel.RGB, Channel.DEPTH))

    @dataclass(kw_only=True)
    class Seen(ObservationGroup):
        near: ObservationTerm | None = camera_depth(camera)
        red: ObservationTerm | None = camera_color(camera)
        concatenate: bool = False

    @dataclass
    class Observations:
        policy: Seen = field(default_factory=Seen)

    environment = Environment(Reach(observations=Observations()), 1)
    depth, color = group_parts(environment.observation["policy"])
    assert (depth.low, depth.high, depth.camera, color.camera) == (0.0, 7.0, "scan", "scan")
    environment.close()


def test_a_node_reads_the_terms_from_ports_of_their_own() -> None:
    made, seen = policy(), observation(2)
    node = PolicyNode(made)
    assert {port.name for port in node.inputs} == {f"policy/{part.name}" for part in PARTS}
    action = node.compute({f"policy/{name}": value for name, value in seen.items()})["action"]
    assert torch.equal(action, made.module(seen))


def test_settings_that_cannot_be_are_refused(tmp_path: Path) -> None:
    picture = Picture("hand_color", 3)
    for build, told in (
        (lambda: Picture("hand_depth", 1, far=0.0), "far of picture 'hand_depth' is finite and above 0"),
        (lambda: Picture("hand_color", 0), "'hand_color' has 1 to 4096 channels, not 0"),
        (lambda: PictureEncoder((picture,), 8, 8, filters=()), "1 to 8 convolutions"),
        (lambda: PictureEncoder((picture,), 8, 8, features=0), "1 to 65536 features"),
        (lambda: PictureEncoder((picture,), 8, 8, places=-1), "0 to 4096 places, not -1"),
        (lambda: PictureEncoder((picture,), 10**5, 10**5), "1 to 4,194,304 pixels"),
        (lambda: Convolutional((), PARTS[:1], (16,)), "at least one picture"),
    ):
        with pytest.raises(ValueError, match=told):
            build()
    with pytest.raises(ConfigurationError, match=r"without pictures \(joints\).*concatenate=True"):
        convolutional(PARTS[:1], (16,))
    labels = replace(PARTS[2], name="labels", dtype="int32")
    with pytest.raises(ConfigurationError, match="'labels' is a picture of int32"):
        convolutional((*PARTS, labels), (16,))
    with pytest.raises(ConfigurationError, match="'hand_depth' is a picture of float32 without bounds"):
        convolutional((replace(PARTS[2], high=None),), (16,))
    made = policy()
    assert made.network is not None
    unfit = replace(DESCRIPTION, observation_parts=PARTS[:3])
    Policy(made.module, ActorNetwork(made.network, made.module).network, unfit).save(tmp_path / "policy_0.safetensors")
    with pytest.raises(ConfigurationError, match="cannot act: KeyError 'front_color'"):
        load_policy(tmp_path)
