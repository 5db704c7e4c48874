"""The output of the verb `simulate`."""

from typing import Any

from skystack.reporting.table import Table


def losses_line(summary: dict[str, Any]) -> str:
    """The losses of separation in one line."""
    count, least_nm = summary["losses_of_separation"], summary["min_separation_nm"]
    if least_nm is None:
        return "losses of separation: none (all aircraft always had vertical separation)"
    return f"losses of separation: {count or 'none'} (minimum separation {least_nm:.2f} NM)"


def headline(summary: dict[str, Any]) -> str:
    """The flight in one line."""
    return f"{summary['scenario']}: {summary['rows']} rows, {summary['final'][0]['time_s']} s"


def summary_table(summary: dict[str, Any]) -> Table:
    """The final state of every aircraft."""
    header = tuple(name.replace("_", " ") for name in _FORMATS)
    lines = (
        tuple(f"{row[name]:{spec}}" for name, spec in _FORMATS.items()) for row in summary["final"]
    )
    return Table(header, tuple(lines))


_FORMATS = {
    "callsign": "",
    "lat": ".4f",
    "lon": ".4f",
    "fl": ".1f",
    "heading_deg": ".1f",
    "ground_speed_kt": ".0f",
    "status": "",
}
"""The columns of the summary and the formats of their values."""
