"""What a command answers: tables, plain data and a figure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from dqforge.reports.pages.table import Table
from dqforge.reports.plain_data import PlainData


@dataclass(frozen=True, slots=True)
class LossReply:
    """The answer: tables for the terminal, plain data for JSON, and what draws its figure."""

    tables: list[Table]
    plain: PlainData
    figure: Callable[[], Any]


@dataclass(frozen=True, slots=True)
class Reply:
    """The answer: tables for the terminal, plain data for JSON, and what draws its figure."""

    tables: list[Table]
    plain: PlainData
    figure: Callable[[], Any]
