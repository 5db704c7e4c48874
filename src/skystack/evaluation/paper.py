"""The numbers that the paper reports (section "Results and Discussion"), 100 scenarios each."""

SCENARIOS = 100
"""The number of scenarios for each figure of the paper."""
PAPER = {
    ("lateral-undamped", False): (113.0, 15.9),
    ("lateral", False): (14.5, 6.6),
    ("lateral", True): (7.2, 3.5),
    ("lateral-large", False): (6.3, 3.0),
    ("avoidance", True): (81.2, 13.2),
    ("avoidance-large", False): (126.3, 12.3),
}
"""(experiment, stacked): mean and standard deviation of the actions per episode."""


def paper_row(experiment: str, stacking: bool) -> dict[str, float] | None:
    """The paper's clearances per scenario for a row; None if it reports none.

    An experiment `NAME-tuned` is compared with the paper's numbers for `NAME`.
    """
    found = PAPER.get((experiment.removesuffix("-tuned"), stacking))
    return {"clearances_mean": found[0], "clearances_std": found[1]} if found else None
