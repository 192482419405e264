"""What the main header offers to every dialect: groups of constants, in their order."""

from __future__ import annotations

from collections.abc import Callable

from dqforge.optimizer.solution import Solution
from dqforge.reports.c_code.header_constant import ConstantGroup
from dqforge.reports.loops.constants import loop_constants
from dqforge.reports.main_header.drive_constants import (
    base_constants,
    machine_constants,
    operation_constants,
)
from dqforge.reports.observers.constants import observer_constants

GROUPS: tuple[Callable[[Solution], list[ConstantGroup]], ...] = (
    machine_constants,
    operation_constants,
    base_constants,
    loop_constants,
    observer_constants,
)


def constant_groups(solution: Solution) -> list[ConstantGroup]:
    """All groups that a solution has."""
    return [group for groups in GROUPS for group in groups(solution)]
