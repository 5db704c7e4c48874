"""The page's own JavaScript predicts losses of separation: against brute force, and in flights."""

from importlib.resources import files

import numpy as np
import pytest
from pyproj import Geod

from skystack.airspace.projection import SCALE_RANGE_NM
from skystack.airspace.sector_file import make_sector, read_sector
from skystack.airspace.xplus import x_plus
from skystack.reporting.replay.page import page_data
from tests.docs.blocks import ROOT

from .pairs import AHEAD_S, STEP_S, BruteForce, flown, predicted, random_pair, replay_of

WGS84 = Geod(ellps="WGS84")
ASK = """
({plane, parts, loss_below_nm: nm, separation_fl: fl, runs}) =>
  runs[0].scenarios.map(packed => {
    const scenario = unpackScenario(packed, parts);
    const found = encountersAt(new Plane(plane), scenario, 0, {nm, fl});
    return found.map(({kind, seconds, nm, at, text}) => ({kind, seconds, nm, at, text}));
  })
"""


@pytest.fixture(scope="module")
def ask(browser):
    """What the page finds at the first row, for each pair; None for nothing."""
    page = browser.new_page()
    script = f"(data) => {{ {source('plane', 'data', 'separation')} return ({ASK})(data); }}"

    def asked(sector, *pairs):
        found = page.evaluate(script, page_data((replay_of(sector, pairs),)))
        return [next(iter(each), None) for each in found]

    yield asked
    page.close()


def source(*names):
    """JavaScript of the page."""
    web = files("skystack.reporting.replay").joinpath("web")
    return "\n".join(web.joinpath(f"{name}.js").read_text("utf-8") for name in names) + "\n"


def north():
    return make_sector(read_sector(ROOT / "verification" / "simulator" / "sectors" / "north.json"))


@pytest.mark.parametrize(("sector", "half_nm"), [(x_plus(), 60.0), (north(), 200.0)])
def test_random_pairs_against_brute_force(ask, sector, half_nm):
    """500 pairs at the equator and 500 between 59 and 66 N."""
    random = np.random.default_rng(17)
    pairs = [random_pair(random, sector, half_nm) for _ in range(500)]
    (earliest, latest), (nearest, farthest) = predicted(sector, pairs)
    found = ask(sector, *pairs)
    certain = {"loss": 0, "conflict": 0, None: 0}
    for number, (pair, met) in enumerate(zip(pairs, found, strict=True)):
        early, late = earliest[number], latest[number]
        kind = met and met["kind"]
        if late == 0.0:
            assert kind == "loss"
        elif early > 0.0 and (late <= AHEAD_S or early > AHEAD_S + STEP_S):
            gone = "exited" in {each.status[0] for each in pair}
            assert kind == ("conflict" if late <= AHEAD_S and not gone else None)
        else:  # too close to call
            continue
        certain[kind] += 1
        if kind == "conflict":
            assert early - STEP_S <= met["seconds"] <= late + STEP_S
            assert nearest[number] <= met["nm"] <= farthest[number]
    assert sum(certain.values()) >= 490
    assert certain["conflict"] >= 80
    assert certain["loss"] >= 40


def test_the_brute_force_is_right():
    """Its distances are those of geodesics; its tracks, headings kept in small geodesic steps."""
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
        # 5 NM beside each other, and behind each other, on equal tracks.
        ({"place_nm": (0.0, -2.5)}, {"place_nm": (0.0, 2.5)}),
        ({"place_nm": (0.0, 0.0)}, {"place_nm": (5.0, 0.0)}),
        # Exactly 1,000 ft: level; after a descent; both climbing; one begins where one ends.
        ({}, {"levels": (310.0, 310.0)}),
        ({}, {"levels": (340.0, 310.0), "climb": (-1731.0,)}),
        (
            {"levels": (300.0, 330.0), "climb": (1533.0,)},
            {"levels": (310.0, 340.0), "climb": (1533.0,)},
        ),
        # Here 92 + 10 + the climb to 400, in floating point, is a little less than 410.
        (
            {"levels": (92.0, 400.0), "climb": (3577.0,)},
            {"levels": (102.0, 450.0), "climb": (3577.0,)},
        ),
        # Through the other's level, before and after being near.
        (
            {"levels": (300.0, 330.0), "climb": (3000.0,)},
            {"levels": (310.0, 310.0), "place_nm": (40.0, 0.0), "heading": 270.0},
        ),
    ],
)
def test_what_is_no_conflict(ask, one, other):
    pair = [
        flown(
            **({"callsign": name, "place_nm": (0.0, 0.0), "heading": EAST, "speed": 480.0} | each)
        )
        for name, each in (("A", one), ("B", other))
    ]
    assert ask(x_plus(), tuple(pair)) == [None]


def test_a_slow_overtake(ask):
    """5 kt faster and 5.5 NM behind: separation is lost after 0.5005 NM, in 360 s; not in 12 more
    minutes at a distance of 6.5 NM."""
    ahead = flown("A", (0.0, 0.0), EAST, 475.0)
    near, far = (
        ask(x_plus(), (ahead, flown("B", (-nm, 0.0), EAST, 480.0)))[0] for nm in (5.5, 6.5)
    )
    assert near["seconds"] == pytest.approx(0.5005 / 5.0 * 3600.0, abs=0.1)
    # Followed for 20 minutes.
    assert near["nm"] == pytest.approx(5.5 - 5.0 * 1200.0 / 3600.0, abs=1e-3)
    assert near["text"] == "in 6:00, min 3.8 NM"
    # Drawn where separation is lost: at 475 kt, and 4.9995 NM behind.
    np.testing.assert_allclose(np.subtract(*near["at"]), [4.9995, 0.0], atol=1e-3)
    assert near["at"][0][0] == pytest.approx(475.0 * 0.5005 / 5.0, abs=0.01)
    assert far is None


def test_a_climb_that_has_not_begun_uses_the_greatest_rate_ever_flown(ask):
    """10 levels to climb until 10 are left: at 500 ft/min in 120 s, at 2,000 in 30."""
    below = {"place_nm": (0.0, 0.0), "heading": EAST, "speed": 480.0, "levels": (280.0, 320.0)}
    above = flown("B", (0.0, 0.0), EAST, 480.0)
    for climb, seconds in (((0.0, 0.0), 30.0), ((0.0, 500.0), 120.0), ((1000.0, 500.0), 60.0)):
        (met,) = ask(x_plus(), (flown("A", **below, climb=climb), above))
        assert met["seconds"] == pytest.approx(seconds, abs=0.01)


def test_distances_are_true_ones_far_north(ask):
    """At 65.3 N, 4.6 NM by geodesic are 5.1 of the plane; at 59.3 N, 5.2 are 4.7."""
    sector = north()

    def beside(lat, nm):
        lon, _, _ = WGS84.fwd(15.0, lat, 90.0, nm * 1852.0)
        places = sector.plane.to_plane([lat, lat], [15.0, lon])
        return tuple(flown(f"A{n}", places[n], 180.0 if lat > 60 else 90.0, 466.0) for n in (0, 1))

    lost, apart = ask(sector, beside(65.3, 4.6), beside(59.3, 5.2))
    assert (lost["kind"], lost["text"]) == ("loss", "4.5 NM")
    assert apart is None


def test_five_nautical_miles_in_the_numbers_of_the_page(ask):
    """Storing positions must not bring two that are 5 NM apart below the tolerance of 0.0005."""
    random = np.random.default_rng(1)
    pairs = []
    for _ in range(300):
        start, bearing = random.uniform(-5.0, 5.0, 2), np.radians(random.uniform(0.0, 360.0))
        offset = 5.0 * np.array([np.sin(bearing), np.cos(bearing)])
        pairs.append(
            tuple(flown(f"A{n}", start + n * offset, EAST, 480.0) for n in (0, 1)),
        )
    assert ask(x_plus(), *pairs) == [None] * 300


def test_where_a_heading_leads_far_north(browser):
    """A minute at 480 kt on any heading, kept in small geodesic steps."""
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
