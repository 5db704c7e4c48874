"""Losses of separation predicted by the page's JavaScript, compared with brute force."""

from dataclasses import replace
from importlib.resources import files

import numpy as np
import pytest
from pyproj import Geod

from skystack.airspace.projection import SCALE_RANGE_NM
from skystack.airspace.sector_file import make_sector, read_sector
from skystack.airspace.xplus import x_plus
from skystack.evaluation.losses import Loss
from skystack.reporting.replay.page import page_data
from tests.docs.blocks import ROOT

from .pairs import (
    LOOKAHEAD_S,
    STEP_S,
    BruteForce,
    aircraft_at,
    brute_force_bounds,
    random_pair,
    replay_of,
)

WGS84 = Geod(ellps="WGS84")
PREDICTION = ("plane", "data", "separation", "prune")
PREDICT = """
({plane, parts, loss_below_nm: nm, separation_fl: fl, runs}) =>
  runs[0].scenarios.map(packed => {
    const scenario = unpackScenario(packed, parts);
    const found = encountersAt(new Plane(plane), scenario, 0, {nm, fl});
    return found.map(({kind, seconds, nm, at, text}) => ({kind, seconds, nm, at, text}));
  })
"""


@pytest.fixture(scope="module")
def predict(browser):
    """A function that returns the page's prediction for each pair at its first row, or None."""
    page = browser.new_page()
    script = f"(data) => {{ {source(*PREDICTION)} return ({PREDICT})(data); }}"

    def predict_pairs(sector, *pairs):
        found = page.evaluate(script, page_data((replay_of(sector, pairs),)))
        return [next(iter(each), None) for each in found]

    yield predict_pairs
    page.close()


def source(*names):
    """The page's JavaScript."""
    web = files("skystack.reporting.replay").joinpath("web")
    return "\n".join(web.joinpath(f"{name}.js").read_text("utf-8") for name in names) + "\n"


def north():
    return make_sector(read_sector(ROOT / "verification" / "simulator" / "sectors" / "north.json"))


@pytest.mark.slow
@pytest.mark.parametrize(("sector", "half_nm"), [(x_plus(), 60.0), (north(), 200.0)])
def test_random_pairs_agree_with_brute_force(predict, sector, half_nm):
    """500 pairs at the equator and 500 between 59 and 66 N."""
    random = np.random.default_rng(17)
    pairs = [random_pair(random, sector, half_nm) for _ in range(500)]
    (earliest, latest), (nearest, farthest) = brute_force_bounds(sector, pairs)
    predictions = predict(sector, *pairs)
    compared = {"loss": 0, "conflict": 0, None: 0}
    for number, (pair, found) in enumerate(zip(pairs, predictions, strict=True)):
        early, late = earliest[number], latest[number]
        kind = found and found["kind"]
        if late == 0.0:
            assert kind == "loss"
        elif early > 0.0 and (late <= LOOKAHEAD_S or early > LOOKAHEAD_S + STEP_S):
            exited = "exited" in {each.status[0] for each in pair}
            assert kind == ("conflict" if late <= LOOKAHEAD_S and not exited else None)
        else:  # too close to call
            continue
        compared[kind] += 1
        if kind == "conflict":
            assert early - STEP_S <= found["seconds"] <= late + STEP_S
            assert nearest[number] <= found["nm"] <= farthest[number]
    assert sum(compared.values()) >= 490
    assert compared["conflict"] >= 80
    assert compared["loss"] >= 40


COMPARE = """
({plane, parts, loss_below_nm: nm, separation_fl: fl, runs}, rows) => {
  const followed = [];
  const scenario = unpackScenario(runs[0].scenarios[0], parts);
  const found = rows.map(row => {
    count = 0;
    const encounters = encountersAt(new Plane(plane), scenario, row, {nm, fl});
    followed.push(count);
    return encounters.map(({kind, pair, seconds, nm, at, text}) =>
      [kind, ...pair.map(({callsign}) => callsign), seconds, nm ?? null, at, text]);
  });
  return [found, followed];
}
"""
COUNTED = """
  let count = 0;
  const closely = conflictOf;
  conflictOf = (...each) => (++count, closely(...each));
"""
EVERY_PAIR = "function staysApart() { return false; }"


@pytest.mark.slow
def test_skipping_distant_pairs_changes_nothing(browser):
    """All pairs of dense traffic far north, followed closely or skipped if they stay apart."""
    random, sector = np.random.default_rng(23), north()
    pairs = [random_pair(random, sector, 150.0) for _ in range(60)]
    aircraft = tuple(replace(each, callsign=f"A{n}") for n, each in enumerate(sum(pairs, start=())))
    data = page_data((replay_of(sector, [aircraft]),))
    page = browser.new_page()

    def found(*extra):
        body = "\n".join((source(*PREDICTION), *extra, COUNTED))
        script = f"([data, rows]) => {{ {body} return ({COMPARE})(data, rows); }}"
        return page.evaluate(script, [data, [0, 1]])

    skipping, every = found(), found(EVERY_PAIR)
    page.close()
    assert skipping[0] == every[0]
    assert min(map(len, every[0])) > 30
    assert max(skipping[1]) < 0.25 * min(every[1])


def test_recorded_losses_are_shown_whatever_the_bound(browser):
    """A loss within the last cycle, of two aircraft that are far apart in the row itself."""
    pair = tuple(
        aircraft_at(f"A{n}", (40.0 * n, 0.0), EAST, 480.0, climb=(0.0, 0.0)) for n in (0, 1)
    )
    (scenario,) = (recording := replay_of(x_plus(), [pair])).scenarios
    lost = replace(scenario, losses=(Loss(0, 1, 0, 1, 4.2),))
    data = page_data((replace(recording, scenarios=(lost,)),))
    page = browser.new_page()
    script = (
        f"([data, rows]) => {{ {source(*PREDICTION)} {COUNTED} return ({COMPARE})(data, rows); }}"
    )
    (none, (found,)), _ = page.evaluate(script, [data, [0, 1]])
    page.close()
    assert none == []
    assert (found[0], found[-1]) == ("loss", "min 4.2 NM")


PLACE = """
({blocks, keepFree, canvas}) => {
  chooseSlots(blocks, keepFree, canvas);
  return blocks.map(({slot}) => slot);
}
"""
EVERY_BOX = "Boxes.prototype.near = function () { return this.all; };"


def test_placing_labels_with_a_grid_changes_nothing(browser):
    random = np.random.default_rng(4)
    blocks = [
        {
            "at": at.tolist(),
            "ahead": (at + random.normal(0.0, 20.0, (4, 2))).tolist(),
            "width": float(random.integers(30, 90)),
            "height": 42.0,
            **({"slot": int(random.integers(24))} if random.random() < 0.5 else {}),
        }
        for at in random.uniform((-50.0, -50.0), (1050.0, 650.0), (200, 2))
    ]
    fixes = [
        {"left": x, "top": y, "width": 50.0, "height": 14.0}
        for x, y in random.uniform((0.0, 0.0), (1000.0, 600.0), (30, 2)).tolist()
    ]
    given = {
        "blocks": blocks,
        "keepFree": fixes,
        "canvas": {"left": 2.0, "top": 2.0, "width": 996.0, "height": 596.0},
    }
    page = browser.new_page()
    grid, every = (
        page.evaluate(f"given => {{ {source('blocks')} {extra} return ({PLACE})(given); }}", given)
        for extra in ("", EVERY_BOX)
    )
    page.close()
    assert grid == every
    assert len(set(grid)) > 10


def test_brute_force_agrees_with_geodesics():
    """Distances agree with geodesics, and tracks with many small geodesic steps."""
    random, sector = np.random.default_rng(5), north()
    pairs = [random_pair(random, sector, 200.0) for _ in range(50)]
    brute = BruteForce(sector, pairs)
    lat, lon = brute.positions()
    heading, speed = (
        np.array([[getattr(pair[n], name)[0] for pair in pairs] for n in (0, 1)])
        for name in ("heading_deg", "ground_speed_kt")
    )
    for _ in range(300):
        lon, lat, _ = WGS84.fwd(lon, lat, heading, speed / 3600.0 * 1852.0)
    for _ in range(3000):
        brute.step()
    apart_m = WGS84.inv(lon[0], lat[0], lon[1], lat[1])[2]
    near = np.array(apart_m) < 10.0 * 1852.0
    assert near.any()
    np.testing.assert_allclose(brute.apart(300.0)[0][near], apart_m[near] / 1852.0, atol=1e-3)


EAST = 90.0


@pytest.mark.parametrize(
    ("one", "other"),
    [
        # Exactly 5 NM apart on equal tracks, side by side and one behind the other.
        ({"place_nm": (0.0, -2.5)}, {"place_nm": (0.0, 2.5)}),
        ({"place_nm": (0.0, 0.0)}, {"place_nm": (5.0, 0.0)}),
        # Exactly 1,000 ft apart: in level flight, after a descent, and both climbing.
        ({}, {"levels": (310.0, 310.0)}),
        ({}, {"levels": (340.0, 310.0), "climb": (-1731.0,)}),
        (
            {"levels": (300.0, 330.0), "climb": (1533.0,)},
            {"levels": (310.0, 340.0), "climb": (1533.0,)},
        ),
        # The same, where 92 + 10 + the climb to 400 is slightly below 410 in floating point.
        (
            {"levels": (92.0, 400.0), "climb": (3577.0,)},
            {"levels": (102.0, 450.0), "climb": (3577.0,)},
        ),
        # Through the other's level, but not while close to it.
        (
            {"levels": (300.0, 330.0), "climb": (3000.0,)},
            {"levels": (310.0, 310.0), "place_nm": (40.0, 0.0), "heading": 270.0},
        ),
    ],
)
def test_no_conflict_at_the_limits(predict, one, other):
    pair = [
        aircraft_at(
            **({"callsign": name, "place_nm": (0.0, 0.0), "heading": EAST, "speed": 480.0} | each)
        )
        for name, each in (("A", one), ("B", other))
    ]
    assert predict(x_plus(), tuple(pair)) == [None]


def test_slow_overtake(predict):
    """At 5 kt faster and 5.5 NM behind, separation is lost after 0.5005 NM, in 360 s. At 6.5 NM
    behind it takes 12 minutes longer, which is beyond the prediction."""
    ahead = aircraft_at("A", (0.0, 0.0), EAST, 475.0)
    near, far = (
        predict(x_plus(), (ahead, aircraft_at("B", (-nm, 0.0), EAST, 480.0)))[0]
        for nm in (5.5, 6.5)
    )
    assert near["seconds"] == pytest.approx(0.5005 / 5.0 * 3600.0, abs=0.1)
    # The minimum within 20 minutes.
    assert near["nm"] == pytest.approx(5.5 - 5.0 * 1200.0 / 3600.0, abs=1e-3)
    assert near["text"] == "in 6:00, min 3.8 NM"
    # Drawn where separation is lost, 4.9995 NM apart; the leading aircraft flies 475 kt.
    np.testing.assert_allclose(np.subtract(*near["at"]), [4.9995, 0.0], atol=1e-3)
    assert near["at"][0][0] == pytest.approx(475.0 * 0.5005 / 5.0, abs=0.01)
    assert far is None


def test_pending_climb_uses_the_greatest_recorded_rate(predict):
    """Separation is lost after a climb of 1,000 ft: 120 s at 500 ft/min, 30 s at 2,000."""
    below = {"place_nm": (0.0, 0.0), "heading": EAST, "speed": 480.0, "levels": (280.0, 320.0)}
    above = aircraft_at("B", (0.0, 0.0), EAST, 480.0)
    for climb, seconds in (((0.0, 0.0), 30.0), ((0.0, 500.0), 120.0), ((1000.0, 500.0), 60.0)):
        (found,) = predict(x_plus(), (aircraft_at("A", **below, climb=climb), above))
        assert found["seconds"] == pytest.approx(seconds, abs=0.01)


def test_distances_are_true_far_north(predict):
    """At 65.3 N, 4.6 NM are 5.1 in the plane; at 59.3 N, 5.2 NM are 4.7."""
    sector = north()

    def beside(lat, nm):
        lon, _, _ = WGS84.fwd(15.0, lat, 90.0, nm * 1852.0)
        places = sector.plane.to_plane([lat, lat], [15.0, lon])
        return tuple(
            aircraft_at(f"A{n}", places[n], 180.0 if lat > 60 else 90.0, 466.0) for n in (0, 1)
        )

    lost, apart = predict(sector, beside(65.3, 4.6), beside(59.3, 5.2))
    assert (lost["kind"], lost["text"]) == ("loss", "4.5 NM")
    assert apart is None


def test_rounding_does_not_reduce_5_nm_to_a_loss(predict):
    """Rounding stored positions must not bring aircraft 5 NM apart below 4.9995 NM."""
    random = np.random.default_rng(1)
    pairs = []
    for _ in range(300):
        start, bearing = random.uniform(-5.0, 5.0, 2), np.radians(random.uniform(0.0, 360.0))
        offset = 5.0 * np.array([np.sin(bearing), np.cos(bearing)])
        pairs.append(
            tuple(aircraft_at(f"A{n}", start + n * offset, EAST, 480.0) for n in (0, 1)),
        )
    assert predict(x_plus(), *pairs) == [None] * 300


def test_constant_headings_are_followed_far_north(browser):
    """A minute at 480 kt on each heading, compared with small geodesic steps."""
    plane = north().plane
    data = {"coefficients": plane.scale.coefficients, "range_nm": SCALE_RANGE_NM}
    page = browser.new_page()
    body = f"{source('plane')} return new Plane(data).reached(at, heading, 8);"
    for heading in range(0, 360, 30):
        lat, lon = 65.5, 16.0
        start = plane.to_plane(lat, lon).tolist()
        for _ in range(80):
            lon, lat, _ = WGS84.fwd(lon, lat, heading, 0.1 * 1852.0)
        there = page.evaluate(f"([data, at, heading]) => {{ {body} }}", [data, start, heading])
        np.testing.assert_allclose(there, plane.to_plane(lat, lon), atol=0.005)
    page.close()
