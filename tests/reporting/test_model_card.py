"""The contents of the model card of each kind of policy."""

import json
import re
import shutil
from dataclasses import replace

import msgspec
import pytest
from huggingface_hub import ModelCard
from huggingface_hub.repocard_data import (
    eval_results_to_model_index,
    model_index_to_eval_results,
)

from skystack.learning.experiment import experiment_from
from skystack.policies.measured import read_measured, to_json
from skystack.policies.shipped import (
    SECTOR_CONTROL,
    SHIPPED,
    find_policy,
    scenario_policies,
    shipped_policies,
)
from skystack.reporting.model_card import card
from skystack.tasks.rewards import REWARDS
from skystack.tasks.sector_rewards import SECTOR_REWARDS


def card_of(name):
    return card(name, find_policy(name), read_measured(SHIPPED / name))


def sentences_of(name):
    """The text of a card without its line breaks."""
    return " ".join(card_of(name).split())


def cells(text, first):
    """The other cells of the table line with the given first cell."""
    line = next(line for line in text.splitlines() if line.startswith(f"| {first} |"))
    return [cell.strip() for cell in line.strip("|").split("|")][1:]


@pytest.mark.parametrize("name", scenario_policies())
def test_card_states_use_licence_training_features_and_rewards(name):
    text, described = card_of(name), find_policy(name).description
    config = described.config
    assert "Never for operational" in text
    assert "Licence: Apache-2.0" in text
    assert f"skystack evaluate {name} " in text
    assert f"{config['ppo']['total_steps']:,} steps" in text
    assert f"--seed {described.seed}" in text
    assert described.sha256[:12] in text
    for feature in (*config["task"]["features"], *config["task"].get("pair_features", ())):
        assert f"| `{feature}" in text
    experiment = experiment_from(config, name)
    parts = [experiment.task.reward]
    if experiment.pretraining is not None:
        parts.append(experiment.pretraining.reward)
    training = text.partition("## Training")[2].partition("## Measured")[0]
    for term in REWARDS:
        paid = any(getattr(reward, term) for reward in parts)
        assert (f"| {term} |" in training) == paid, term


@pytest.mark.parametrize("name", shipped_policies())
def test_tables_are_complete(name):
    """Every line of a table has as many cells as the header, and follows without a gap."""
    widths = set()
    for block in card_of(name).split("\n\n"):
        lines = [line for line in block.splitlines() if line.startswith("|")]
        if lines:
            assert lines == block.strip().splitlines()
            assert re.fullmatch(r"\|(-+:?\|)+", lines[1])
            assert len({line.count("|") for line in lines}) == 1
            widths.add(lines[0])
    assert len(widths) == 3


def test_card_shows_the_measured_numbers():
    found = read_measured(SHIPPED / "lateral")
    rows = [row | {"clearances_mean": 11.04, "clearances_std": 2.0} for row in found.rows]
    rows[-1] |= {"success_rate": 0.9876, "excursion_rate": 0.0004, "few_clearances_rate": 0.9881}
    rows[-1] |= {"exit_offset_nm_mean": 4.26}
    text = card("lateral", find_policy("lateral"), msgspec.structs.replace(found, rows=rows))
    assert cells(text, "clearances") == ["11.0 ± 2.0"] * 3
    assert cells(text, "clearances in the paper") == ["14.5 ± 6.6", "7.2 ± 3.5", "7.2 ± 3.5"]
    assert cells(text, "success")[-1] == "98.8 %"
    assert cells(text, "exit offset, NM")[-1] == "4.3"
    assert (
        "124 of 10,000 scenarios fail with stacking, including 4 with an excursion and 119 with an "
        "aircraft that receives 30 clearances or more."
    ) in " ".join(text.split())
    rows[-1] |= {"success_rate": 1.0}
    text = card("lateral", find_policy("lateral"), msgspec.structs.replace(found, rows=rows))
    assert "None of 10,000 scenarios fails" in text


def test_card_states_the_reading_of_the_paper():
    policy, found = find_policy("lateral"), read_measured(SHIPPED / "lateral")
    config = json.loads(json.dumps(policy.description.config))
    config["task"] |= {"exit_nm": 5.0, "airway_nm": 10.0}
    config["ppo"]["normalise_observations"] = False
    described = msgspec.structs.replace(policy.description, config=config)
    text = card("lateral", replace(policy, description=described), found)
    assert (
        "- every aircraft leaves through its exit, at most 5 NM from the middle of the exit" in text
    )
    assert "- there is no excursion, also none of more than 10 NM from the route" in text
    assert "Observations are normalised" not in text
    assert "Observations are normalised first." in card_of("lateral")


def test_lists_the_rewards_of_both_parts_of_training():
    text, config = card_of("avoidance-best"), find_policy("avoidance-best").description.config
    first, last = config["pretraining"]["reward"], config["task"]["reward"]
    sentence = f"the first {config['pretraining']['steps']:,} with other reward weights"
    assert sentence in sentences_of("avoidance-best")
    assert first["conflict"] != last["conflict"]
    for name in ("burst", "conflict", "conflict_nm"):
        assert cells(text, name)[1:] == [f"{first[name]:g}", f"{last[name]:g}"]
    assert "band_nm" not in text


def test_names_the_ends_of_the_exit_edge_by_their_sides():
    """`theta_xl` is to the left of an exiting aircraft, `theta_xr` to its right."""
    text = card_of("lateral-best")
    assert "left end" in cells(text, "`theta_xl`")[0]
    assert "right end" in cells(text, "`theta_xr`")[0]


def test_limitations_match_the_task():
    assert "does not avoid other traffic" in sentences_of("lateral-best")
    assert "does not avoid other traffic" not in sentences_of("avoidance-best")
    assert "Separation is still lost" in sentences_of("avoidance")
    # (1 - 3 / n) ** n is about 0.05: the rule of three.
    none = "Separation was lost in none of 10,000 scenarios. With 95 % confidence"
    assert none in sentences_of("avoidance-best")
    assert "the rate of losses is below 3 in 10,000" in sentences_of("avoidance-best")
    vertical = sentences_of("vertical")
    assert "There is no other traffic" in vertical
    assert "from its entry level to its exit level" in vertical
    assert "loss of separation" not in vertical


def test_names_the_count_criterion_only_if_it_applies():
    assert "receives fewer than 30 instructions" in sentences_of("lateral")
    assert "receives fewer than 30 instructions" not in sentences_of("lateral-undamped")


def test_measured_values_round_trip(tmp_path):
    found = read_measured(SHIPPED / "lateral")
    (tmp_path / "measured.json").write_bytes(to_json(found))
    assert read_measured(tmp_path) == found
    assert json.loads(to_json(found))["rows"][1]["command"].startswith("skystack evaluate lateral")
    assert read_measured(tmp_path / "nowhere") is None


def uploaded(folder):
    """The card as the Hugging Face hub reads it: from README.md."""
    return ModelCard.load(folder / "README.md")


@pytest.mark.parametrize("name", scenario_policies())
def test_hub_reads_metadata_and_measurements(name):
    """The metadata are parsed by the hub's own library; its online check was not run."""
    parsed = uploaded(SHIPPED / name)
    data, found = parsed.data, read_measured(SHIPPED / name)
    assert (data.license, data.library_name) == ("apache-2.0", "skystack")
    assert data.pipeline_tag == "reinforcement-learning"
    assert {"reinforcement-learning", "air-traffic-control"} <= set(data.tags)
    assert data.model_name == name
    assert parsed.text.strip().startswith(f"# Model card: {name}\n")
    task = find_policy(name).description.task_name
    assert {(each.task_name, each.dataset_type) for each in data.eval_results} == {
        (task, f"skystack-{task}")
    }
    values = {}
    for each in data.eval_results:
        values.setdefault(each.dataset_config, {})[each.metric_type] = each.metric_value
    commands = [row["command"] for row in found.rows]
    assert [f"skystack evaluate {name} {options} --json" for options in values] == commands
    for shown, row in zip(values.values(), found.rows, strict=True):
        assert {"clearances_mean", "clearances_std", "success_rate"} <= set(shown)
        assert ("loss_of_separation_count" in shown) == (task != "vertical")
        assert shown == {metric: row[metric] for metric in shown}
    index = data.to_dict()["model-index"]
    assert eval_results_to_model_index(*model_index_to_eval_results(index)) == index


def test_the_card_of_sector_control_has_a_column_for_each_traffic():
    text, found = card_of(SECTOR_CONTROL), read_measured(SHIPPED / SECTOR_CONTROL)
    described = find_policy(SECTOR_CONTROL).description
    assert found.sha256 == described.sha256
    traffic = [row["traffic"] for row in found.rows]
    assert traffic == ["120", "60", "30", "200", "category", "120"]
    names = [*(f"{rate} flights/h" for rate in (120, 60, 30, 200)), "`category`", "120 flights/h"]
    assert f"| | {' | '.join(names)} |" in text.splitlines()
    assert cells(text, "flights") == [f"{row['flights']:,}" for row in found.rows]
    assert cells(text, "safety net") == ["yes"] * 5 + ["no"]
    assert cells(text, "losses of separation") == [
        f"{row['losses_of_separation']:,}" for row in found.rows
    ]
    assert "Never for operational" in text
    for term in SECTOR_REWARDS:
        assert f"| {term} |" in text
    data = uploaded(SHIPPED / SECTOR_CONTROL).data
    assert {each.dataset_type for each in data.eval_results} == {"skystack-sector-control"}
    commands = [row["command"] for row in found.rows]
    options = list(dict.fromkeys(each.dataset_config for each in data.eval_results))
    assert [f"skystack evaluate {SECTOR_CONTROL} {each} --json" for each in options] == commands


def test_hub_reads_names_as_text():
    found = read_measured(SHIPPED / "vertical")
    for name in ("null", "1e3", "x.y-z_0"):
        assert ModelCard(card(name, find_policy("vertical"), found)).data.model_name == name


def test_a_policy_folder_is_complete(tmp_path):
    """An uploaded and downloaded folder is a policy, and its card links to no other file."""
    for name in shipped_policies():
        files = {path.name for path in (SHIPPED / name).iterdir()}
        assert files == {"README.md", "measured.json", "policy.json", "policy.safetensors"}
        assert "](" not in uploaded(SHIPPED / name).text
    folder = shutil.copytree(SHIPPED / "vertical", tmp_path / "downloaded")
    (folder / ".gitattributes").write_text("*.safetensors filter=lfs\n")  # the hub adds it
    assert find_policy(folder).description == find_policy("vertical").description
