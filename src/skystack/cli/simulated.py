"""What the verb `simulate` prints."""

from typing import Any

from skystack.reporting.tables import Table


def losses_line(summary: dict[str, Any]) -> str:
    """Losses of separation in a line, for a terminal."""
    count, least_nm = summary["losses_of_separation"], summary["min_separation_nm"]
    if least_nm is None:
        return "losses of separation: none (no two aircraft without vertical separation)"
    return f"losses of separation: {count or 'none'} (least distance {least_nm:.2f} NM)"


def headline(summary: dict[str, Any]) -> str:
    """What was flown, in a line."""
    return f"{summary['scenario']}: {summary['rows']} rows, {summary['final'][0]['time_s']} s"


def summary_table(summary: dict[str, Any]) -> Table:
    """Where the aircraft ended."""
    header = tuple(name.replace("_", " ") for name in _SHOWN)
    lines = (
        tuple(f"{row[name]:{how}}" for name, how in _SHOWN.items()) for row in summary["final"]
    )
    return Table(header, tuple(lines))


_SHOWN = {
    "callsign": "",
    "lat": ".4f",
    "lon": ".4f",
    "fl": ".1f",
    "heading_deg": ".1f",
    "ground_speed_kt": ".0f",
    "status": "",
}
"""Columns of the summary and how their values are written."""
