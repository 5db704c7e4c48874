"""Rows, results and trainings made by hand, with a different value in each column."""

from skystack.reporting.results import Paper, Results, Row, Training


def row(**changes):
    values = {"experiment": "lateral", "platform": "skystack", "stacking": True, "seeds": 3}
    values |= {"episodes": 3000, "clearances_mean": 7.16, "clearances_std": 3.45}
    values |= {"instructions_mean": 14.5, "success_rate": 0.9876, "correct_exit_rate": 1.0}
    values |= {"excursion_rate": 0.0124, "few_clearances_rate": None}
    values |= {"loss_of_separation_count": 2, "paper": Paper(7.2, 3.5)}
    return Row(**(values | changes))


def results(**changes):
    values = {"rows": [], "rows_by_seed": [], "train": []}
    values |= {"wall_s": 1.0, "machine": "", "version": "", "command": "", "quick": False}
    return Results(**(values | changes))


def training(experiment, seed=0):
    return Training(experiment, seed, 2_007_040, 62.0, 32371.6)
