"""What a study asks of its rows, and which steps that takes."""

from __future__ import annotations

from dqforge.machines.records import dataclass
from dqforge.optimizer.variant_steps.outputs import Output, Step

# Steps of a row without a fixed header, in the order in which refusals count.
STEPS: tuple[Step, ...] = ("limit", "fit", "current-loops", "speed-loop", "losses")


@dataclass(frozen=True, slots=True)
class Asked:
    """What a study asks of its rows.

    Args:
        outputs: All outputs.
        named: Those that the study itself names: a row without them has no solution.
    """

    outputs: tuple[Output, ...]
    named: frozenset[str] = frozenset()

    @property
    def steps(self) -> tuple[Step, ...]:
        """Steps that make them; the speed loop's makes the current loops as well."""
        wanted = {output.step for output in self.outputs}
        if "speed-loop" in wanted:
            wanted.discard("current-loops")
        return tuple(step for step in STEPS if step in wanted)

    def of_step(self, step: Step) -> tuple[Output, ...]:
        """Outputs of a step."""
        return tuple(output for output in self.outputs if output.step == step)

    @property
    def gains_named(self) -> bool:
        """Whether the study itself asks for gains or margins."""
        return any(name.startswith("gains.") for name in self.named)
