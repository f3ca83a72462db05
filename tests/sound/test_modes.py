"""Vibration modes against closed forms and published tables."""

from __future__ import annotations

import math

import pytest
import torch

from orbit_core.interfaces import ConfigurationError
from orbit_core.scene import Box, Capsule, Cylinder, Plane, Shape, Sphere
from orbit_sound import (
    MATERIALS,
    Modes,
    SoundMaterial,
    bar_modes,
    disc_modes,
    plate_modes,
    rod_modes,
    shape_modes,
    sphere_modes,
)
from orbit_sound.bank import ModalBank
from orbit_sound.modes import sphere_roots

STEEL = MATERIALS["steel"]
CPU = torch.device("cpu")
RATE = 16_000


def material(**changes: float) -> SoundMaterial:
    constants = {"density": 1000.0, "young": 1e9, "poisson": 0.3, "mass_damping": 10.0, "stiffness_damping": 0.0}
    return SoundMaterial(name="stuff", **{**constants, **changes})


def test_a_bar_rings_at_the_frequencies_of_euler_and_bernoulli() -> None:
    length, thickness = 0.3, 0.01
    modes = bar_modes(length, thickness, 0.03, STEEL)
    # Rossing and Fletcher, section 2.15: f_n = pi K / (8 L^2) sqrt(E / rho) (3.011^2, 5^2, 7^2 ...), K = h / sqrt(12).
    first = math.pi * thickness / math.sqrt(12.0) / (8.0 * length**2) * math.sqrt(STEEL.young / STEEL.density)
    expected = [first * value**2 for value in (3.0112, 5.0, 7.0, 9.0)]
    assert modes.frequencies[:4] == pytest.approx(expected, rel=5e-4)


def test_a_round_rod_rings_as_a_bar_of_its_radius_of_gyration() -> None:
    radius = 0.005
    rod, bar = rod_modes(0.3, radius, STEEL), bar_modes(0.3, radius * math.sqrt(3.0), 0.01, STEEL)
    assert rod.frequencies == pytest.approx(bar.frequencies)


def test_a_square_plate_rings_as_leissas_table_says() -> None:
    side, thickness = 0.2, 0.002
    stuff = material()
    flexural = stuff.young * thickness**3 / (12.0 * (1.0 - 0.3**2))
    scale = math.sqrt(flexural / (stuff.density * thickness)) / side**2 / (2.0 * math.pi)
    # NASA SP-160, table 4.75: 13.489 for the mode with two crossing nodal lines; Warburton's formula is 5 % above it.
    assert plate_modes(side, side, thickness, stuff).frequencies[0] / scale == pytest.approx(13.489, rel=0.06)


def test_a_disc_rings_lowest_with_two_nodal_diameters() -> None:
    stuff = material(poisson=0.33)
    flexural = stuff.young * 0.002**3 / (12.0 * (1.0 - 0.33**2))
    expected = 5.253 / (2.0 * math.pi * 0.1**2) * math.sqrt(flexural / (stuff.density * 0.002))
    assert disc_modes(0.1, 0.002, stuff).frequencies[0] == pytest.approx(expected, rel=1e-6)


def test_a_sphere_rings_at_lambs_roots() -> None:
    # Lamb, On the vibrations of an elastic sphere, 1882; Love, Elasticity, chapter 12, for Poisson's ratio 1/4: the
    # spheroidal mode of second order at 0.840 pi, and breathing at 0.8160 pi of the pressure wave, sqrt 3 faster.
    assert sphere_roots(2, 0.25)[0] == pytest.approx(0.840 * math.pi, rel=2e-3)
    assert sphere_roots(0, 0.25)[0] == pytest.approx(0.8160 * math.pi * math.sqrt(3.0), rel=2e-3)
    plastic = MATERIALS["plastic"]
    assert sphere_modes(0.2, plastic).frequencies[0] == pytest.approx(2.0 * sphere_modes(0.4, plastic).frequencies[0])


def test_modes_of_a_shape_are_those_of_the_nearest_closed_form() -> None:
    assert shape_modes(Shape(Box((0.005, 0.15, 0.015))), STEEL) == bar_modes(0.3, 0.01, 0.03, STEEL)
    assert shape_modes(Shape(Box((0.1, 0.002, 0.15))), STEEL) == plate_modes(0.3, 0.2, 0.004, STEEL)
    assert shape_modes(Shape(Cylinder(0.1, 0.001)), STEEL) == disc_modes(0.1, 0.002, STEEL)
    assert shape_modes(Shape(Cylinder(0.005, 0.15)), STEEL) == rod_modes(0.3, 0.005, STEEL)
    assert shape_modes(Shape(Capsule(0.005, 0.145)), STEEL) == rod_modes(0.3, 0.005, STEEL)
    assert shape_modes(Shape(Sphere(0.2)), STEEL) == sphere_modes(0.2, STEEL)


def test_the_bank_sounds_as_the_sum_of_damped_sines_whatever_the_chunk() -> None:
    modes = Modes((440.0, 1234.5), (30.0, 80.0), (2.0, 0.5), 1.0)
    time = torch.arange(160, dtype=torch.float64) / RATE
    rows = zip(modes.frequencies, modes.decays, modes.gains, strict=True)
    truth = sum(
        3.0 * gain * torch.exp(-decay * time) * torch.sin(2 * math.pi * hertz * time) for hertz, decay, gain in rows
    )
    for chunk in (16, 40, 160):
        bank = ModalBank([modes], 1, RATE, chunk, CPU)
        first = bank.ring(torch.tensor([[3.0]]), torch.ones(1, 1, dtype=torch.bool))
        rest = [bank.ring(torch.zeros(1, 1), torch.zeros(1, 1, dtype=torch.bool)) for _ in range(160 // chunk - 1)]
        assert torch.allclose(torch.cat((first, *rest), 2)[0, 0].double(), truth, atol=1e-5)


def test_an_impact_that_an_engine_spreads_over_steps_sounds_as_one() -> None:
    modes = Modes((440.0, 1234.5), (0.0, 0.0), (2.0, 0.5), 1.0)
    whole, parts = (ModalBank([modes], 1, RATE, 32, CPU) for _ in range(2))
    yes, no = torch.ones(1, 1, dtype=torch.bool), torch.zeros(1, 1, dtype=torch.bool)
    whole.ring(torch.tensor([[4.0]]), yes)
    for share, fresh in ((1.0, yes), (2.0, no), (1.0, no)):
        parts.ring(torch.tensor([[share]]), fresh)
    assert torch.allclose(whole.amplitudes.norm(dim=0), parts.amplitudes.norm(dim=0), rtol=1e-5)


def test_impulses_within_a_chunk_sound_as_they_would_at_its_beginning() -> None:
    modes = Modes((440.0, 1234.5), (30.0, 80.0), (2.0, 0.5), 1.0)
    no = torch.zeros(1, 1, dtype=torch.bool)
    fine, coarse = ModalBank([modes], 1, RATE, 1, CPU), ModalBank([modes], 1, RATE, 32, CPU)
    impulses = torch.randn(1, 1, 32, generator=torch.Generator().manual_seed(0))
    sound = coarse.ring(torch.zeros(1, 1), no, impulses)
    singly = [fine.ring(torch.zeros(1, 1), no, impulses[..., i : i + 1]) for i in range(32)]
    assert torch.allclose(sound, torch.cat(singly, 2), atol=1e-5)
    assert torch.allclose(coarse.amplitudes, fine.amplitudes, atol=1e-5)


def test_the_energy_of_a_ring_grows_with_the_square_of_the_impulse() -> None:
    modes = bar_modes(0.3, 0.01, 0.03, STEEL)
    bank = ModalBank([modes], 3, RATE, 320, CPU)
    impulses = torch.tensor([[1.0], [2.0], [4.0]])
    energy = bank.ring(impulses, torch.ones(3, 1, dtype=torch.bool)).square().sum((1, 2))
    assert (energy / energy[0]).tolist() == pytest.approx([1.0, 4.0, 16.0], rel=1e-5)


def test_constants_that_no_material_has_are_refused() -> None:
    with pytest.raises(ConfigurationError, match="sound material 'stuff' needs density"):
        material(young=-1.0)
    with pytest.raises(ConfigurationError, match="from 0 to below"):
        material(poisson=0.5)
    with pytest.raises(ConfigurationError, match="as many frequencies as decays"):
        Modes((1.0,), (), (), 1.0)
    with pytest.raises(ConfigurationError, match="a Plane has no vibration modes"):
        shape_modes(Shape(Plane()), STEEL)
