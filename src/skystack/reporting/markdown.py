"""`results.md`: the tables of a run as Markdown."""

from collections.abc import Iterator

from skystack.errors import printable
from skystack.reporting import tables
from skystack.reporting.claims import check_claims, claims_table
from skystack.reporting.families import family_title
from skystack.reporting.results import Run
from skystack.reporting.table import plain_markdown


def as_markdown(run: Run) -> str:
    """All tables of a run, grouped by family."""
    return "\n".join(_parts(run))


def _parts(run: Run) -> Iterator[str]:
    results, claims = run.results, check_claims(run)
    command, made = printable(results.command).replace("`", "'"), (results.machine, results.version)
    machine, version = map(plain_markdown, made)
    yield f"`{command}`; {machine}; skystack {version}\n"
    for family, rows in results.families.items():
        yield f"## {family_title(family)}\n"
        yield tables.comparison(rows, run.bound_of(family), results.is_trained).as_markdown()
        for table in (
            tables.estimates(rows),
            tables.seeds_side_by_side(results, rows),
            claims_table([claim for claim in claims if claim.family == family]),
        ):
            if table.rows:
                yield table.as_markdown()
    if results.sampled:
        yield "## Sampled actions\n"
        yield tables.sampled(results).as_markdown()
    if results.comparisons:
        yield "## Pairwise comparisons\n"
        yield tables.comparisons(results).as_markdown()
    if results.platforms:
        yield "## Other simulators\n"
        yield tables.platforms(results.platforms).as_markdown()
    yield "## Training runs\n"
    yield tables.trainings(results).as_markdown()
