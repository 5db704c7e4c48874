"""Policy files load exactly as saved, and damaged ones are rejected."""

import hashlib
import json
import subprocess
import sys
from importlib.metadata import PackageNotFoundError
from pathlib import Path

import jax
import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from safetensors.numpy import load, save

from skystack.errors import InputError
from skystack.learning.inference import Normaliser
from skystack.learning.policy import Policy, load_policy, package_versions, save_policy
from skystack.policies.shipped import SHIPPED, find_policy, shipped_policies


@pytest.fixture
def folder(tmp_path):
    save_policy(tmp_path, find_policy("lateral"))
    return tmp_path


def rewrite(folder, **changes):
    description = json.loads((folder / "policy.json").read_text())
    (folder / "policy.json").write_text(json.dumps(description | changes))


def test_round_trip_keeps_the_logits(folder):
    seen = np.random.default_rng(0).uniform(size=(50, 8)).astype(np.float32)
    original = find_policy("lateral")
    np.testing.assert_array_equal(load_policy(folder).logits(seen), original.logits(seen))
    assert load_policy(folder)(seen[0]) == int(np.argmax(original.logits(seen[0])))


@pytest.mark.parametrize("name", shipped_policies())
def test_shipped_policies_load(name):
    policy = find_policy(name)
    assert policy.description.experiment == name
    assert policy.description.config["name"] == name


def test_shipped_policies_are_small():
    assert sum(path.stat().st_size for path in SHIPPED.rglob("*.*")) < 2_000_000


def test_policy_needs_only_numpy():
    """Loading and querying a policy does not import JAX."""
    program = (
        "import sys; from skystack.policies.shipped import SHIPPED; "
        "from skystack.learning.policy import load_policy; import numpy as np; "
        "print(load_policy(SHIPPED / 'lateral')(np.full(8, 0.5)), 'jax' in sys.modules)"
    )
    program = program.replace(
        "from skystack.policies.shipped import SHIPPED",
        f"from pathlib import Path; SHIPPED = Path({str(SHIPPED)!r})",
    )
    found = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert found.stdout.split()[1] == "False"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"format": 99}, "format 99"),
        ({"sha256": "0" * 64}, "sha256"),
        ({"hidden": [64, 32]}, "actor.1.weights"),
        ({"surprise": 1}, "surprise"),
        ({"seed": "zero"}, "policy description"),
    ],
)
def test_rejects_a_changed_description(folder, changes, message):
    rewrite(folder, **changes)
    with pytest.raises(InputError, match=message):
        load_policy(folder)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("actor.0.biases", np.nan, r"actor\.0\.biases.*non-finite"),
        ("normaliser.variance", -1.0, "variance.*negative"),
        ("actor.1.weights", 3e38, "could overflow"),
    ],
)
def test_rejects_non_finite_negative_or_huge_tensors(folder, name, value, message):
    tensors = load((folder / "policy.safetensors").read_bytes())
    tensors[name] = np.full_like(tensors[name], value)
    data = save(tensors)
    (folder / "policy.safetensors").write_bytes(data)
    rewrite(folder, sha256=hashlib.sha256(data).hexdigest())
    with pytest.raises(InputError, match=message):
        load_policy(folder)


@given(st.binary(max_size=200))
def test_rejects_random_bytes_in_one_line(tmp_path_factory, data):
    folder = tmp_path_factory.mktemp("damaged")
    (folder / "policy.json").write_bytes(data)
    with pytest.raises(InputError) as error:
        load_policy(folder)
    assert "\n" not in str(error.value)


def one_layer(weights, biases, mean=(0.0, 0.0), variance=(1.0, 1.0)):
    """A policy with one layer, two observed values and three actions."""
    description = msgspec.structs.replace(
        find_policy("lateral").description,
        observation=("a", "b"),
        actions=("none", "left", "right"),
        hidden=(),
    )
    normaliser = Normaliser(np.float32(mean), np.float32(variance), np.float32(0.0))
    return Policy(description, ((np.float32(weights), np.float32(biases)),), normaliser)


def test_takes_the_most_probable_action(tmp_path):
    """By hand: 0.8 is two deviations above its mean, which favours the third action."""
    policy = one_layer([[0, 1, 2], [1, 0, 0]], [1, 0.5, 0], (0.6, 0.0), (0.01, 1.0))
    save_policy(tmp_path, policy)
    for queried in (policy, load_policy(tmp_path)):
        assert queried.logits(np.float32([0.8, 0.0])) == pytest.approx([1.0, 2.5, 4.0], abs=1e-4)
        seen = np.array([[0.8, 0.0], [0.6, 0.0], [0.6, -9.0]])
        assert [queried(row) for row in seen] == [2, 0, 1]
        assert type(queried(seen[0])) is int
    names = {"normaliser.mean", "normaliser.variance", "actor.0.weights", "actor.0.biases"}
    assert set(load((tmp_path / "policy.safetensors").read_bytes())) == names


@pytest.mark.parametrize(
    ("weight", "bias", "mean", "rejected"),
    [
        (4e28, 5e29, 0.0, False),  # at most 9e29, at ten deviations
        (6e28, 5e29, 0.0, True),
        (-6e28, -5e29, 0.0, True),
        (1.0, 1.1e30, 0.0, True),
        (1.0, 0.9e30, 0.0, False),
        (1.0, 0.0, 1.1e30, True),
        (1.0, 0.0, -0.9e30, False),
        (1.0, 0.0, -1.1e30, True),
    ],
)
def test_rejects_weights_whose_logits_could_overflow(tmp_path, weight, bias, mean, rejected):
    save_policy(tmp_path, one_layer([[weight, 0, 0], [0, 0, 0]], [bias, 0, 0], mean=(mean, 0.0)))
    if rejected:
        with pytest.raises(InputError, match="could overflow"):
            load_policy(tmp_path)
    else:
        load_policy(tmp_path)


@pytest.mark.parametrize(
    ("name", "tensor", "message"),
    [
        ("normaliser.mean", None, "'normaliser.mean' is missing"),
        ("normaliser.variance", np.ones(3, np.float32), r"float32 \(3,\) .allowed: float32 \(2,\)"),
        ("actor.0.weights", np.ones((3, 2), np.float32), r"float32 \(3, 2\)"),
        ("actor.0.biases", np.ones(3), r"float64 \(3,\) .allowed: float32"),
    ],
)
def test_tensors_must_fit_the_description(tmp_path, name, tensor, message):
    save_policy(tmp_path, one_layer(np.ones((2, 3)), np.zeros(3)))
    tensors = load((tmp_path / "policy.safetensors").read_bytes())
    del tensors[name]
    data = save(tensors | ({} if tensor is None else {name: tensor}))
    (tmp_path / "policy.safetensors").write_bytes(data)
    rewrite(tmp_path, sha256=hashlib.sha256(data).hexdigest())
    with pytest.raises(InputError, match=message):
        load_policy(tmp_path)


def test_rejects_a_file_that_is_not_safetensors(tmp_path):
    save_policy(tmp_path, one_layer(np.ones((2, 3)), np.zeros(3)))
    (tmp_path / "policy.safetensors").write_bytes(b"none")
    rewrite(tmp_path, sha256=hashlib.sha256(b"none").hexdigest())
    with pytest.raises(InputError, match="not a safetensors file"):
        load_policy(tmp_path)


def test_allows_a_variance_of_zero(tmp_path):
    save_policy(tmp_path, one_layer(np.ones((2, 3)), np.zeros(3), variance=(0.0, 1.0)))
    assert np.all(np.isfinite(load_policy(tmp_path).logits(np.ones(2, np.float32))))


def test_records_package_versions(monkeypatch):
    found = package_versions()
    assert (found["numpy"], found["jax"]) == (np.__version__, jax.__version__)
    assert set(found) == {"skystack", "jax", "jaxlib", "optax", "numpy"}

    def not_found(name):
        raise PackageNotFoundError

    monkeypatch.setattr("skystack.learning.policy.version", not_found)
    assert set(package_versions().values()) == {"unknown"}


def test_rejects_an_unknown_policy():
    with pytest.raises(InputError, match="did you mean 'lateral'"):
        find_policy("laterla")
    for name in ("x" * 300, Path("nowhere")):
        with pytest.raises(InputError, match=r"unknown policy .*a folder with a policy.json, or "):
            find_policy(name)


def test_policy_folder_may_be_a_path(folder):
    assert find_policy(folder).description == find_policy(str(folder)).description


@pytest.mark.parametrize(
    ("observation", "problem"),
    [
        (np.zeros((1, 8)), r"has shape \(1, 8\)"),
        (np.zeros(7), r"has shape \(7,\)"),
        (0.0, r"has shape \(\)"),
        (None, r"has shape \(\)"),
        ([0.0] * 7 + [np.nan], r"is \[.* nan\]"),
        ([np.inf] * 8, r"is \[inf .*\]"),
    ],
)
def test_rejects_a_malformed_or_non_finite_observation(observation, problem, types_unchecked):
    with pytest.raises(
        InputError, match=rf"^the observation {problem} \(allowed: 8 finite numbers"
    ):
        find_policy("lateral")(observation)
