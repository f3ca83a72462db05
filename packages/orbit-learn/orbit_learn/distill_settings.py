"""How a policy is distilled from another unless told otherwise."""

from __future__ import annotations

from dataclasses import dataclass

from orbit_core.interfaces.errors import ConfigurationError


@dataclass(frozen=True)
class DistillSettings:
    """Imitation of a teacher in the states that the student comes to: Ross, Gordon and Bagnell, A Reduction of
    Imitation Learning and Structured Prediction to No-Regret Online Learning (2011), known as DAgger.

    The learning rate falls to zero along half a cosine: Loshchilov and Hutter, SGDR (2017).
    """

    teacher: str = ""
    """A kept policy's name, a policy's file, a training's folder, or ``expert``, the task's own."""
    iterations: int = 1000
    """Number of iterations, each of collecting steps and learning from them."""
    steps_per_iteration: int = 16
    """Environment steps that every environment contributes to an iteration."""
    hidden_sizes: tuple[int, ...] = (256, 128)
    """Units of the hidden layers behind the encoders of pictures."""
    teacher_led: float = 0.2
    """Share of the training during which the teacher leads some episodes: all at first, then fewer and fewer."""
    buffer_size: int = 200_000
    """Steps that are remembered to learn from; with two cameras of 64 x 64 pixels, 41 kB each on the device."""
    updates_per_iteration: int = 32
    """Steps of gradient descent."""
    batch_size: int = 2048
    """Remembered steps that each of them takes."""
    learning_rate: float = 1e-3
    """Learning rate at first."""
    shift: int = 0
    """Most pixels that pictures are shifted by, at random, while learning: Yarats et al., Mastering Visual Continuous
    Control: Improved Data-Augmented Reinforcement Learning (2021)."""
    mixed_precision: bool = False
    """Whether to compute gradients in bfloat16 where numbers allow it."""

    def __post_init__(self) -> None:
        for name in ("iterations", "steps_per_iteration", "buffer_size", "updates_per_iteration", "batch_size"):
            if getattr(self, name) < 1:
                raise ConfigurationError(f"{name} of a distillation is 1 or more, not {getattr(self, name)}")
        if not 0.0 <= self.teacher_led <= 1.0:
            raise ConfigurationError(f"teacher_led of a distillation is a share in [0, 1], not {self.teacher_led}")
        if self.shift < 0 or self.learning_rate <= 0.0:
            raise ConfigurationError("shift of a distillation is not negative, and its learning_rate above zero")
