"""Follow a training run in an experiment tracker: `on_update` is called after each update.

    pip install trackio                             # or mlflow
    python examples/tracked_training.py lateral-best --tracker trackio

trackio writes to this machine; `trackio show` opens its dashboard. wandb has the same functions as
trackio. Any other tracker needs a function of the measured values and the step, and one that ends
the run.
"""

import argparse
from pathlib import Path

import skystack


def trackio_run(name):
    import trackio

    trackio.init(project="skystack", name=name)
    return trackio.log, trackio.finish


def mlflow_run(name):
    import mlflow

    mlflow.set_experiment("skystack")
    mlflow.start_run(run_name=name)
    return mlflow.log_metrics, mlflow.end_run


TRACKERS = {"trackio": trackio_run, "mlflow": mlflow_run}


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("experiment", help="a name (see `skystack list`) or a .toml file")
    parser.add_argument("--tracker", choices=TRACKERS, default="trackio")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="run folder (default runs/EXPERIMENT-sSEED)")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", dest="changes")
    options = parser.parse_args()

    experiment = skystack.load_experiment(options.experiment, options.changes)
    name = f"{experiment.name}-s{options.seed}"
    log, finish = TRACKERS[options.tracker](name)

    def on_update(progress):
        # A value is None if no scenario ended in the update.
        values = {key: value for key, value in progress.measured.items() if value is not None}
        log(values, step=progress.steps)

    out = options.out or Path("runs") / name
    skystack.train_experiment(experiment, options.seed, out, on_update=on_update)
    finish()
    print("policy:", out / "policy.json")


if __name__ == "__main__":
    main()
