"""Zips of Stable-Baselines3: they give its answers, and nothing in them is executed."""

import base64
import io
import json
import pickle
import sys
import zipfile

import gymnasium
import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

import torch
from gymnasium import spaces
from stable_baselines3 import A2C, DQN, PPO, SAC
from stable_baselines3.common.torch_layers import FlattenExtractor

import skystack
from skystack.agents.agent import agent_of
from skystack.agents.find import find_agent
from skystack.agents.sb3_agent import read_sb3
from skystack.errors import InputError

OBSERVATIONS, ACTIONS = 8, 5
"""As in lateral navigation."""
RELU = {"activation_fn": torch.nn.ReLU, "net_arch": {"pi": [32, 16], "vf": [8]}}


class RandomEnvironment(gymnasium.Env):
    """An environment with these spaces, and with random observations."""

    def __init__(self, action_space=None, observation_space=None):
        self.observation_space = observation_space or spaces.Box(
            0.0, 1.0, (OBSERVATIONS,), np.float32
        )
        self.action_space = action_space or spaces.Discrete(ACTIONS)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return self.observation_space.sample(), {}

    def step(self, action):
        return self.observation_space.sample(), 0.0, False, False, {}


def make_model(kind, environment=None, policy="MlpPolicy", **settings):
    small = {DQN: {"buffer_size": 10}, SAC: {"buffer_size": 10}}.get(kind, {})
    return kind(
        policy, environment or RandomEnvironment(), device="cpu", seed=1, **small, **settings
    )


def with_large_weights(model):
    """The model with weights as large as trained ones. Initial ones hardly prefer an action."""
    with torch.no_grad():
        for parameter in model.policy.parameters():
            parameter.copy_(torch.randn(parameter.shape) * 0.5)
    return model


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    """A model's file."""
    path = tmp_path_factory.mktemp("model") / "model.zip"
    make_model(PPO).save(path)
    return path


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "settings"),
    [
        (PPO, {}),
        (PPO, {"policy_kwargs": RELU}),
        (PPO, {"policy_kwargs": {"net_arch": []}}),
        (A2C, {}),
        (A2C, {"policy_kwargs": {"activation_fn": torch.nn.ReLU}}),
        (DQN, {}),
        (DQN, {"policy_kwargs": {"activation_fn": torch.nn.Tanh, "net_arch": [8]}}),
    ],
    ids=["PPO", "PPO ReLU", "PPO linear", "A2C", "A2C ReLU", "DQN", "DQN Tanh"],
)
def test_gives_the_answers_of_stable_baselines3(kind, settings, tmp_path):
    model = with_large_weights(make_model(kind, **settings))
    model.save(tmp_path / "model.zip")
    agent = find_agent(str(tmp_path / "model.zip"))
    observations = (
        np.random.default_rng(0).uniform(-1.0, 2.0, (2000, OBSERVATIONS)).astype(np.float32)
    )
    expected, _ = model.predict(observations, deterministic=True)
    assert len(set(expected.tolist())) > 2
    np.testing.assert_array_equal(agent.scores(observations).argmax(axis=1), expected)
    np.testing.assert_array_equal(agent_of(model).act(observations), expected)
    assert agent_of(model).observations == agent.observations == OBSERVATIONS
    assert agent_of(model).actions == agent.actions == ACTIONS
    assert agent.logits == (kind is not DQN)
    if agent.logits:
        logits = model.policy.get_distribution(torch.as_tensor(observations)).distribution.logits
        found = agent.scores(observations)
        found -= np.log(np.exp(found).sum(axis=1, keepdims=True))
        np.testing.assert_allclose(found, logits.detach().numpy(), atol=1e-4)


@pytest.mark.slow
def test_a_model_in_memory_uses_its_normaliser():
    """The statistics of `VecNormalize` are not in the zip, but the model in memory has them."""
    from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

    normalised = VecNormalize(DummyVecEnv([RandomEnvironment]))
    normalised.obs_rms.mean, normalised.obs_rms.var = (
        np.full(OBSERVATIONS, 0.3),
        np.full(OBSERVATIONS, 0.01),
    )
    model = with_large_weights(make_model(PPO, normalised))
    observations = np.random.default_rng(0).uniform(size=(500, OBSERVATIONS)).astype(np.float32)
    expected, _ = model.predict(normalised.normalize_obs(observations), deterministic=True)
    np.testing.assert_array_equal(agent_of(model).act(observations), expected)
    assert not np.array_equal(model.predict(observations, deterministic=True)[0], expected)


@pytest.mark.slow
def test_evaluates_a_model_and_its_file(tmp_path):
    model = with_large_weights(make_model(PPO))
    model.save(tmp_path / "my model.zip")
    conditions = skystack.Conditions(episodes=3)
    file = skystack.find_agent(str(tmp_path / "my model.zip"))
    results = [
        skystack.evaluate(each, conditions, experiment="lateral-undamped") for each in (model, file)
    ]
    assert results[0].clearances.equals(results[1].clearances)
    assert [one.row["experiment"] for one in results] == ["PPO", "my-model"]
    sampled = skystack.evaluate(
        file, conditions._replace(greedy=False), experiment="lateral-undamped"
    )
    assert not sampled.clearances.equals(results[0].clearances)


def rewritten(path, target, **parts):
    """A copy with some parts replaced, or left out if None."""
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(target, "w") as new:
        for name in old.namelist():
            data = parts.get(name.partition(".")[0], old.read(name))
            if data is not None:
                new.writestr(name, data)
    return target


def data_with(path, **changes):
    with zipfile.ZipFile(path) as file:
        return json.dumps(json.loads(file.read("data")) | changes).encode()


def serialised(tensors):
    data = io.BytesIO()
    torch.save(tensors, data)
    return data.getvalue()


def test_accepts_weights_that_were_saved_as_parameters(path, tmp_path):
    """The values are the same; the difference matters only for training in PyTorch."""
    with zipfile.ZipFile(path) as file:
        tensors = torch.load(io.BytesIO(file.read("policy.pth")), weights_only=True)
    parameters = {name: torch.nn.Parameter(tensor) for name, tensor in tensors.items()}
    other = read_sb3(rewritten(path, tmp_path / "other.zip", policy=serialised(parameters)))
    observations = np.random.default_rng(0).uniform(size=(500, OBSERVATIONS)).astype(np.float32)
    np.testing.assert_array_equal(other.scores(observations), read_sb3(path).scores(observations))


class Evil:
    """Creates a file when it is unpickled."""

    def __init__(self, mark):
        self.mark = mark

    def __reduce__(self):
        return eval, (f"open({str(self.mark)!r}, 'w').close()",)


def test_nothing_in_the_file_is_executed(path, tmp_path):
    mark = tmp_path / "mark"
    evil = base64.b64encode(pickle.dumps(Evil(mark))).decode()
    policy = {"__module__": "stable_baselines3.common.policies", ":serialized:": evil}
    data = data_with(path, policy_class=policy, clip_range={":serialized:": evil})
    read_sb3(rewritten(path, tmp_path / "evil.zip", data=data))
    assert not mark.exists()
    for part in (serialised({"action_net.weight": Evil(mark)}), pickle.dumps(Evil(mark))):
        with pytest.raises(InputError, match=r"part 'policy.pth' is damaged|is not a zip"):
            read_sb3(rewritten(path, tmp_path / "evil.zip", policy=part))
        assert not mark.exists()
    with zipfile.ZipFile(tmp_path / "evil.zip") as file:
        pickle.loads(file.read("policy.pth"))
    assert mark.exists()  # plain unpickling executes it


@pytest.mark.parametrize("module", [{}, [], 3, None])
def test_rejects_a_policy_module_that_is_not_a_string(path, tmp_path, module):
    data = data_with(path, policy_class={"__module__": module})
    with pytest.raises(InputError, match="its policy class is from "):
        read_sb3(rewritten(path, tmp_path / "odd.zip", data=data))


def bomb(size):
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("archive/data.pkl", bytes(size))
    return data.getvalue()


def test_rejects_zip_bombs(path, tmp_path):
    target = tmp_path / "bomb.zip"
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as new:
        new.writestr("policy.pth", old.read("policy.pth"))
        new.writestr("data", b" " * 100_000_000)
    with pytest.raises(InputError, match=r"its part 'data' is too large .allowed: 16 MB.$"):
        read_sb3(target)
    with pytest.raises(InputError, match=r"data.pkl' is too large .allowed: 64 MB in all.$"):
        read_sb3(rewritten(path, target, policy=bomb(70_000_000)))
    with zipfile.ZipFile(target, "w") as file:
        for number in range(1001):
            file.writestr(str(number), b"")
    with pytest.raises(InputError, match="has 1001 parts"):
        read_sb3(target)
    with pytest.raises(InputError, match="is not JSON"):
        read_sb3(rewritten(path, target, data=b"[" * 1_000_000))


def test_rejects_damaged_files(path, tmp_path):
    whole, target = path.read_bytes(), tmp_path / "model.zip"
    for data in (b"", b"no zip", whole[: len(whole) // 2], whole[:200] + whole[400:]):
        target.write_bytes(data)
        with pytest.raises(InputError):
            read_sb3(target)
    for part in ("data", "policy"):
        with pytest.raises(InputError, match=rf"exactly one part '{part}.*allowed: PPO, A2C, DQN"):
            read_sb3(rewritten(path, target, **{part: None}))
    with pytest.raises(InputError, match="is not a JSON object"):
        read_sb3(rewritten(path, target, data=b"[]"))


def weights(**changes):
    tensors = dict(make_model(PPO).policy.state_dict())
    return serialised(tensors | {name.replace("__", "."): value for name, value in changes.items()})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"action_net__bias": torch.zeros(4)}, r"tensors action_net.weight and .bias do not fit"),
        ({"action_net__bias": torch.full((5,), torch.nan)}, "holds a non-finite number"),
        ({"action_net__bias": torch.zeros(5, dtype=torch.float64)}, "is torch.float64"),
        ({"action_net__bias": torch.zeros(1).expand(5)}, "allowed: dense float32"),
        ({"action_net__bias": 5}, "holds more than tensors"),
        ({"mlp_extractor__policy_net__5__weight": torch.zeros(5, 5)}, r"layers are .*\[0, 2, 5\]"),
        (
            {"features_extractor__cnn__0__weight": torch.zeros(5)},
            "has an unexpected tensor 'features_extr",
        ),
        ({"action_net__weight": torch.zeros(5, 9)}, "do not fit"),
        ({"action_net__weight": torch.zeros(6, 64), "action_net__bias": torch.zeros(6)}, "n 5"),
    ],
)
def test_rejects_unexpected_weights(changes, message, path, tmp_path):
    with pytest.raises(InputError, match=message):
        read_sb3(rewritten(path, tmp_path / "model.zip", policy=weights(**changes)))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: make_model(SAC, RandomEnvironment(spaces.Box(-1.0, 1.0, (2,)))),
            "its policy class is from '.*sac",
        ),
        (
            lambda: make_model(PPO, RandomEnvironment(spaces.Box(-1.0, 1.0, (2,)))),
            "has an unexpected tensor 'log_std'",
        ),
        (
            lambda: make_model(PPO, RandomEnvironment(spaces.MultiDiscrete([2, 3]))),
            "its action space is .*multi",
        ),
        (
            lambda: make_model(PPO, RandomEnvironment(None, spaces.Discrete(7))),
            "its observation space is .*discrete",
        ),
        (
            lambda: make_model(PPO, policy_kwargs={"activation_fn": torch.nn.ELU}),
            r"its activation_fn is .*ELU.* \(allowed: Tanh, ReLU\)",
        ),
        (
            lambda: make_model(PPO, policy_kwargs={"features_extractor_class": FlattenExtractor}),
            "its policy_kwargs have features_extractor_class",
        ),
    ],
    ids=["SAC", "Box actions", "MultiDiscrete", "Discrete observations", "ELU", "extractor"],
)
def test_rejects_unsupported_models(make, message, tmp_path):
    make().save(tmp_path / "model.zip")
    with pytest.raises(InputError, match=rf"^.*model.zip: {message}"):
        read_sb3(tmp_path / "model.zip")


def test_reports_that_torch_is_missing_or_too_old(path, monkeypatch):
    monkeypatch.setattr(torch, "__version__", "2.5.1+cpu")
    with pytest.raises(InputError, match=r"model.zip needs torch 2.6 or newer, installed is 2.5.1"):
        read_sb3(path)
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(InputError, match=r"model.zip needs torch, .* the extra \[sb3\]"):
        read_sb3(path)
