"""All dialects of the main header."""

from __future__ import annotations

from dqforge.reports.main_header.dialects.neutral.names import NEUTRAL

DIALECTS = {dialect.name: dialect for dialect in (NEUTRAL,)}
