"""What every emitted file says of itself: its prefix, the design, the tool's version
and the input's checksum.
"""

from __future__ import annotations

from dqforge import __version__
from dqforge.machines.design.design import Design
from dqforge.reports.plain_data import PlainData


def title(design: Design) -> PlainData:
    """First lines of a header: ``prefix``, ``macro`` (the prefix in capitals), ``name``,
    ``version``, ``digest``.
    """
    prefix = design.export.prefix
    return {
        "prefix": prefix,
        "macro": prefix.upper(),
        "name": design.name,
        "version": __version__,
        "digest": design.digest,
    }
