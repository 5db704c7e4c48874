"""Policy files: what was saved comes back, and nothing else is believed."""

import json
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from safetensors.numpy import load, save

from skystack.catalogue import SHIPPED, find_policy, shipped_policies
from skystack.errors import InputError
from skystack.learning.policy import load_policy, save_policy


@pytest.fixture
def folder(tmp_path):
    save_policy(tmp_path, find_policy("lateral"))
    return tmp_path


def rewrite(folder, **changes):
    described = json.loads((folder / "policy.json").read_text())
    (folder / "policy.json").write_text(json.dumps(described | changes))


def test_a_policy_survives_the_disk(folder):
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


def test_a_policy_needs_numpy_alone():
    """Loading and asking a policy imports no JAX."""
    program = (
        "import sys; from skystack.catalogue import SHIPPED; "
        "from skystack.learning.policy import load_policy; import numpy as np; "
        "print(load_policy(SHIPPED / 'lateral')(np.full(8, 0.5)), 'jax' in sys.modules)"
    )
    program = program.replace(
        "from skystack.catalogue import SHIPPED",
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
def test_a_changed_description_is_refused(folder, changes, message):
    rewrite(folder, **changes)
    with pytest.raises(InputError, match=message):
        load_policy(folder)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("actor.0.biases", np.nan, r"actor\.0\.biases.*non-finite"),
        ("normaliser.variance", -1.0, "variance.*negative"),
        ("actor.1.weights", 3e38, "would overflow"),
    ],
)
def test_weights_that_would_give_no_number_are_refused(folder, name, value, message):
    tensors = load((folder / "policy.safetensors").read_bytes())
    tensors[name] = np.full_like(tensors[name], value)
    data = save(tensors)
    (folder / "policy.safetensors").write_bytes(data)
    import hashlib

    rewrite(folder, sha256=hashlib.sha256(data).hexdigest())
    with pytest.raises(InputError, match=message):
        load_policy(folder)


@given(st.binary(max_size=200))
def test_bytes_that_are_no_policy_are_refused_in_one_line(tmp_path_factory, data):
    folder = tmp_path_factory.mktemp("damaged")
    (folder / "policy.json").write_bytes(data)
    with pytest.raises(InputError) as error:
        load_policy(folder)
    assert "\n" not in str(error.value)


def test_a_policy_that_is_not_there():
    with pytest.raises(InputError, match="did you mean 'lateral'"):
        find_policy("laterla")
