"""Random pairs of aircraft, and their losses of separation by brute force on the ellipsoid.

All numbers lie on the page's own grid, so that storing them does not change them.
"""

import numpy as np

from skystack.reporting.replay.page import PARTS
from skystack.reporting.replay.recording import RecordedAircraft, Replay, ReplayScenario

LOOKAHEAD_S = 600
PREDICTED_S = 1200
STEP_S = 0.1
USUAL_FT_MIN = 2000.0
A_M, E2 = 6378137.0, 0.0066943799901413165  # WGS 84


def on_grid(value, unit):
    return np.rint(np.asarray(value) * PARTS[unit]) / PARTS[unit]


def aircraft_at(
    callsign, place_nm, heading, speed, levels=(300.0, 300.0), climb=(0.0, 0.0), status=None
):
    """An aircraft whose rows differ only in the vertical speed, given by `climb`."""
    rows = len(climb)
    fl, cleared = levels
    return RecordedAircraft(
        callsign=callsign,
        type="B753",
        route=(),
        entry_fl=fl,
        exit_fl=300,
        position_nm=np.tile(on_grid(place_nm, "nm"), (rows, 1)),
        fl=np.full(rows, on_grid(fl, "fl")),
        heading_deg=np.full(rows, on_grid(heading, "deg")),
        cleared_heading_deg=np.full(rows, on_grid(heading, "deg")),
        cleared_fl=np.full(rows, on_grid(cleared, "fl")),
        ground_speed_kt=np.full(rows, on_grid(speed, "kt")),
        vertical_speed_ft_min=np.array(climb),
        status=(status or "in_sector",) * rows,
    )


def replay_of(sector, pairs):
    """A replay with one scenario per pair."""
    return Replay(
        "pairs",
        sector,
        tuple(ReplayScenario(n, 2, None, pair, (), ()) for n, pair in enumerate(pairs)),
    )


def random_pair(random, sector, half_nm):
    """Two aircraft that pass within a few miles in about 15 minutes, or follow one another."""
    middle, heading = random.uniform(-half_nm, half_nm, 2), random.uniform(0.0, 360.0)
    speeds = random.uniform(250.0, 540.0, 2)
    headings = np.array([heading, random.uniform(0.0, 360.0)])
    kind = random.choice(["crossing", "overtake", "equal"], p=[0.6, 0.25, 0.15])
    if kind == "crossing":
        seconds = random.uniform(-100.0, 1000.0)
        miss = random.uniform(0.0, 7.0) * unit(random.uniform(0.0, 360.0))
        offset = miss - seconds / 3600.0 * (
            speeds[1] * unit(headings[1]) - speeds[0] * unit(heading)
        )
    else:
        headings[1] = heading + random.choice([0.0, random.uniform(-2.0, 2.0)])
        speeds[1] = speeds[0] - random.choice([5.0, random.uniform(0.0, 40.0)])
        offset = random.uniform(4.5, 7.0) * unit(heading + random.normal(0.0, 10.0))
    if kind == "equal":
        headings[1], speeds[1] = heading, speeds[0]
        offset = random.uniform(4.7, 5.6) * unit(random.uniform(0.0, 360.0))
    places = (middle, middle + sector.plane.scale(middle[1:]) * offset)
    return tuple(
        aircraft_at(f"AC{n}", places[n], headings[n], speeds[n], *random_climb(random))
        for n in (0, 1)
    )


def random_climb(random):
    """Level and cleared level, current and other vertical speed, and status."""
    fl = 300.0 + random.choice([0.0, 0.0, 0.0, 5.0, 10.0, random.uniform(-30.0, 30.0)])
    cleared = fl
    if random.random() < 0.5:
        cleared = 300.0 + 10.0 * random.integers(-2, 3)
    rate = float(random.integers(300, 3500)) * np.sign(cleared - fl)
    begun = random.random() < 0.7
    usual = float(random.integers(300, 3500)) if random.random() < 0.5 else 0.0
    climb = (rate, 0.0) if begun else (0.0, usual)
    status = random.choice(
        ["in_sector", "before_entry", "excursion", "exited"], p=[0.7, 0.2, 0.05, 0.05]
    )
    return (fl, cleared), climb, str(status)


def unit(degrees):
    return np.array([np.sin(np.radians(degrees)), np.cos(np.radians(degrees))])


class BruteForce:
    """Flies all pairs in steps of 0.1 s: at constant heading and speed on WGS 84, and at a constant
    rate to the cleared level."""

    def __init__(self, sector, pairs):
        both = [[pair[n] for pair in pairs] for n in (0, 1)]

        def value(name):
            return np.array([[getattr(each, name)[0] for each in side] for side in both])

        places = np.array([[each.position_nm[0] for each in side] for side in both])
        lat, lon = np.moveaxis(sector.plane.to_degrees(places), -1, 0)
        self._lat, self._lon = np.radians(lat), np.radians(lon)
        speed = value("ground_speed_kt") * 1852.0 / 3600.0
        heading = np.radians(value("heading_deg"))
        self._north, self._east = speed * np.cos(heading), speed * np.sin(heading)
        self._fl, self._cleared = value("fl"), value("cleared_fl")
        climbs = np.array([[each.vertical_speed_ft_min for each in side] for side in both])
        most = np.abs(climbs).max(axis=2)
        now = np.abs(climbs[..., 0])
        rate = np.where(now > 0.0, now, np.where(most > 0.0, most, USUAL_FT_MIN)) / 6000.0
        self._rate = rate * np.sign(self._cleared - self._fl)

    def step(self):
        """Fly one step, with the radii of the ellipsoid at its middle."""
        half = self._lat + self._north / meridian_m(self._lat) * (STEP_S / 2.0)
        self._lat = self._lat + self._north / meridian_m(half) * STEP_S
        self._lon = self._lon + self._east / parallel_m(half) * STEP_S

    def apart(self, seconds):
        """The distance [NM] (by the radii at the mean latitude) and the level difference [FL]."""
        lat, lon = self._lat.mean(axis=0), np.diff(self._lon, axis=0)[0]
        north, east = np.diff(self._lat, axis=0)[0] * meridian_m(lat), lon * parallel_m(lat)
        moved = self._fl + self._rate * seconds
        up = self._rate > 0.0
        level = np.where(up, np.minimum(moved, self._cleared), np.maximum(moved, self._cleared))
        level = np.where(self._rate == 0.0, self._fl, level)
        return np.hypot(east, north) / 1852.0, np.abs(level[1] - level[0])

    def positions(self):
        return np.degrees(self._lat), np.degrees(self._lon)


def meridian_m(lat):
    return A_M * (1.0 - E2) / (1.0 - E2 * np.sin(lat) ** 2) ** 1.5


def parallel_m(lat):
    return A_M * np.cos(lat) / np.sqrt(1.0 - E2 * np.sin(lat) ** 2)


MODEL_NM = 0.01
"""The tolerance of the page's distances: it assumes straight relative motion for a minute, which is
correct within 0.007 NM at 66 N (a sagitta of tan(lat) v^2 / R times 60 s squared / 8)."""
TICK_FL = 1.0 / 6000.0


def brute_force_bounds(sector, pairs):
    """The time at which each pair loses separation [s], and its least distance while not vertically
    separated [NM]: for both, the lowest and highest values that the steps and `MODEL_NM` allow.

    Between two steps, distances and levels change by no more than in the previous step, except at
    turning points, where distances change by less than `MODEL_NM` and climbs end.
    """
    brute = BruteForce(sector, pairs)
    first = np.full((2, len(pairs)), np.inf)
    least = np.full((2, len(pairs)), np.inf)
    nm_before, fl_before = brute.apart(0.0)
    for step in range(round(PREDICTED_S / STEP_S) + 1):
        nm, fl = brute.apart(step * STEP_S)
        more_nm, more_fl = MODEL_NM + np.abs(nm - nm_before), np.abs(fl - fl_before)
        for n, sign in enumerate((1.0, -1.0)):
            close = fl < sector.separation_fl - TICK_FL / 2.0 + sign * more_fl
            lost = close & (nm < sector.loss_below_nm + sign * more_nm)
            first[n] = np.where(lost & np.isinf(first[n]), step * STEP_S, first[n])
            least[n] = np.where(close, np.minimum(least[n], nm - sign * more_nm), least[n])
        nm_before, fl_before = nm, fl
        brute.step()
    return first, least
