"""Rows, results and trainings made by hand, with a different value in each column."""

from skystack.evaluation.hour_row import HourRow
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


def hour_row(agent, traffic, **changed):
    """A row of an hour of traffic."""
    values = {
        "agent": agent,
        "traffic": traffic,
        "sector": "x-plus",
        "hours": 2.0,
        "cycles": 600,
        "seed": 1,
        "per_cycle": 5,
        "uncertainty": False,
        "safety_net": None,
        "flights": 1234,
        "losses_of_separation": 3,
        "losses_at_birth": 1,
        "correct_exit_rate": 0.987,
        "excursion_rate": 0.001,
        "fail_safe_rate": 0.91,
        "transmissions_per_flight": 2.345,
        "transmissions_worst_minute": 10,
        "extra_miles_rate": 0.012,
        "lax_s_mean": 3456.7,
        "lax_s_by_hour": [3313.4, 3600.0],
        "strict_s_mean": 1234.5,
        "decision_ms_median": 4.56,
    }
    return HourRow(**(values | changed))
