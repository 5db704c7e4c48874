"""The page's prediction of losses, against brute force at a tenth of a second."""

import json
from importlib.resources import files

import numpy as np
import pytest

from skystack.airspace.projection import SCALE_RANGE_NM, MercatorPlane

from .browser import ARGUMENTS

PAIRS, LOOK_AHEAD_S, STEP_S = 1000, 600, 0.1
LIMIT_NM, LIMIT_FL = 4.9995, 10.0
PLANES = {"equator": MercatorPlane(0.0, 0.0), "north": MercatorPlane(62.5, 15.0)}


@pytest.fixture(scope="module")
def page():
    """A page with the replay's own functions in it."""
    playwright = pytest.importorskip("playwright.sync_api")
    web = files("skystack.reporting.replay").joinpath("web")
    scripts = [web.joinpath(f"{name}.js").read_text("utf-8") for name in ("data", "separation")]
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path="/usr/bin/chromium", args=ARGUMENTS)
        opened = browser.new_page()
        opened.add_script_tag(content="\n".join(scripts))
        yield opened
        browser.close()


def random_pairs(place):
    """Two aircraft each: fast and slow, level, climbing or about to, some overtaking slowly."""
    rng = np.random.default_rng(len(place))
    shape = (PAIRS, 2)
    heading = rng.uniform(0.0, 360.0, shape)
    speed = rng.uniform(150.0, 520.0, shape)
    y = rng.uniform(-150.0, 150.0, PAIRS)
    scale = PLANES[place].scale(y)
    apart, angle = rng.uniform(5.5, 110.0, PAIRS), rng.uniform(0.0, 2.0 * np.pi, PAIRS)
    heading[:, 0] = np.degrees(angle) + rng.uniform(-20.0, 20.0, PAIRS)  # most meet, or nearly
    meeting = rng.random(PAIRS) < 0.5
    heading[meeting, 1] = heading[meeting, 0] + 180.0 + rng.uniform(-20.0, 20.0, meeting.sum())
    behind = rng.random(PAIRS) < 0.3  # one in the trail of the other, a little faster
    heading[behind, 1] = heading[behind, 0] + rng.uniform(-3.0, 3.0, behind.sum())
    speed[behind, 1] = speed[behind, 0] + rng.uniform(5.0, 60.0, behind.sum())
    apart[behind] = rng.uniform(5.1, 12.0, behind.sum())
    angle[behind] = np.radians(heading[behind, 0] + 180.0)
    offset = (apart * scale)[:, None] * np.stack([np.sin(angle), np.cos(angle)], axis=1)
    first = np.stack([rng.uniform(-150.0, 150.0, PAIRS), y], axis=1)
    fl = rng.integers(200, 400, shape).astype(float)
    near = rng.random(PAIRS) < 0.8
    fl[near, 1] = fl[near, 0] + rng.choice([0.0, 0.0, 9.9, 10.0, -10.0, 30.0], near.sum())
    cleared = np.where(rng.random(shape) < 0.75, fl, rng.integers(20, 41, shape) * 10.0)
    climb = rng.choice([0.0, 1200.0, 2500.0], shape) * np.sign(cleared - fl)
    return {
        "position": np.stack([first, first + offset], axis=1),
        "heading": heading % 360.0,
        "speed": speed,
        "fl": fl,
        "cleared": cleared,
        "climb": climb,
        "usual": rng.choice([1500.0, 2500.0], shape),
    }


def brute_force(place, pairs):
    """Seconds until each pair is closer than both standards, on present tracks; inf if never."""
    time = np.arange(0.0, LOOK_AHEAD_S + STEP_S, STEP_S)[:, None]
    one, other = pairs["position"][:, 0], pairs["position"][:, 1]
    nm = 1.0 / PLANES[place].scale((one[:, 1] + other[:, 1]) / 2.0)
    radians = np.radians(pairs["heading"])
    velocity = (pairs["speed"] / 3600.0)[..., None] * np.stack(
        [np.sin(radians), np.cos(radians)], axis=-1
    )
    offset, motion = (other - one) * nm[:, None], velocity[:, 1] - velocity[:, 0]
    distance = np.hypot(*(offset[:, axis] + time * motion[:, axis] for axis in range(2)))
    to_go = pairs["cleared"] - pairs["fl"]
    rate = np.where(pairs["climb"] != 0.0, np.abs(pairs["climb"]), pairs["usual"]) / 6000.0
    moved = np.minimum(rate * time[..., None], np.abs(to_go)) * np.sign(to_go)
    level = pairs["fl"] + moved
    lost = (distance < LIMIT_NM) & (np.abs(level[..., 1] - level[..., 0]) < LIMIT_FL - 1e-9)
    return np.where(lost.any(axis=0), time[lost.argmax(axis=0), 0], np.inf)


def predicted(page, place, pairs):
    """Seconds until the loss that the page predicts, and the least distance; inf without one."""
    scale = PLANES[place].scale
    aircraft = [
        [
            {
                "xNm": [float(pairs["position"][number, who, 0])],
                "yNm": [float(pairs["position"][number, who, 1])],
                **{
                    name: [float(pairs[key][number, who])]
                    for name, key in (
                        ("headingDeg", "heading"),
                        ("speedKt", "speed"),
                        ("fl", "fl"),
                        ("clearedFl", "cleared"),
                        ("climbFtMin", "climb"),
                    )
                },
                "usualClimbFtMin": float(pairs["usual"][number, who]),
            }
            for who in range(2)
        ]
        for number in range(PAIRS)
    ]
    given = {
        "pairs": aircraft,
        "nm": LIMIT_NM,
        "fl": LIMIT_FL,
        "scale": {"coefficients": scale.coefficients, "range_nm": SCALE_RANGE_NM},
    }
    found = page.evaluate(
        """text => {
            const {pairs, nm, fl, scale} = JSON.parse(text);
            const limits = {nm, fl, scale: scaleOf(scale)};
            return pairs.map(pair => {
                const found = predictedLoss(...pair.map(each => motion(each, 0)), limits);
                return found === null ? null : [found.seconds, found.nm];
            });
        }""",
        json.dumps(given),
    )
    return np.array([each or (np.inf, np.inf) for each in found])


@pytest.mark.parametrize("place", PLANES)
def test_amber_comes_with_the_first_cycle_that_leads_to_a_loss_in_time(page, place):
    pairs = random_pairs(place)
    exact, (seconds, least_nm) = brute_force(place, pairs), predicted(page, place, pairs).T
    within = seconds <= LOOK_AHEAD_S
    # Steps of 0.1 s see a loss late, and miss one that is over between two of them.
    missed = within & np.isinf(exact)
    assert not np.any(np.isfinite(exact) & ~within)
    assert missed.sum() <= 3
    both = within & np.isfinite(exact)
    assert np.all(exact[both] >= seconds[both] - 1e-6)
    assert np.all(exact[both] <= seconds[both] + STEP_S + 1e-6)
    assert np.all(least_nm[both] < LIMIT_NM)
    assert both.sum() > 100
    assert (~both).sum() > 300


@pytest.mark.parametrize("place", PLANES)
def test_the_least_distance_is_that_of_the_loss(page, place):
    """By brute force over the time that the two are vertically close, well into the future."""
    pairs = random_pairs(place)
    found = predicted(page, place, pairs)
    late = np.arange(0.0, 4000.0, 0.5)[:, None]
    one, other = pairs["position"][:, 0], pairs["position"][:, 1]
    nm = 1.0 / PLANES[place].scale((one[:, 1] + other[:, 1]) / 2.0)
    radians = np.radians(pairs["heading"])
    velocity = (pairs["speed"] / 3600.0)[..., None] * np.stack(
        [np.sin(radians), np.cos(radians)], axis=-1
    )
    offset, motion = (other - one) * nm[:, None], velocity[:, 1] - velocity[:, 0]
    distance = np.hypot(*(offset[:, axis] + late * motion[:, axis] for axis in range(2)))
    to_go = pairs["cleared"] - pairs["fl"]
    rate = np.where(pairs["climb"] != 0.0, np.abs(pairs["climb"]), pairs["usual"]) / 6000.0
    level = pairs["fl"] + np.minimum(rate * late[..., None], np.abs(to_go)) * np.sign(to_go)
    close = np.abs(level[..., 1] - level[..., 0]) < LIMIT_FL - 1e-9
    least = np.where(close & (distance < LIMIT_NM), distance, np.inf).min(axis=0)
    seen = np.isfinite(least) & (found[:, 0] <= LOOK_AHEAD_S)
    assert seen.sum() > 100
    assert np.all(found[seen, 1] <= least[seen] + 1e-9)
    assert np.all(least[seen] - found[seen, 1] < 0.15)  # what they close in half a second


def test_exactly_the_standards_are_no_conflict(page):
    """Side by side at 5 NM, above each other at 1,000 ft, and climbing to that."""
    pairs = {name: np.array(values) for name, values in random_pairs("equator").items()}
    pairs["position"][:3] = [[[0.0, 0.0], [5.0, 0.0]], [[0.0, 0.0], [1.0, 0.0]], [[0.0, 0.0]] * 2]
    pairs["heading"][:3], pairs["speed"][:3] = 0.0, 450.0
    pairs["fl"][:3] = [[300.0, 300.0], [300.0, 310.0], [300.0, 340.0]]
    pairs["cleared"][:3] = [[300.0, 300.0], [300.0, 310.0], [300.0, 310.0]]
    found = predicted(page, "equator", pairs)
    assert np.all(np.isinf(found[:3]))
