// The monitor: the pairs that will come close, as points over time and distance.

const MONITOR = { left: 26, right: 10, top: 8, bottom: 18, minutes: 18, nm: 15 };
const URGENT_S = 120; // a loss this soon is marked by a filled symbol and, if wanted, by sound

class Monitor {
  constructor(scope, cycleS, goTo) {
    Object.assign(this, { limits: scope.limits, cycleS, goTo, drawn: "", warned: new Set() });
    [this.pairs, this.cycle] = [[], null];
    scope.predict = (...at) => this.encounters(...at);
    document.querySelector(".encounters").after(byId("monitor-section").content);
    this.canvas = byId("monitor");
    this.sound = null;
    new ResizeObserver(() => this.draw()).observe(this.canvas);
    this.canvas.addEventListener("click", (event) => {
      const found = this.nearest(event);
      if (found) this.goTo(found.callsigns);
    });
    this.canvas.addEventListener("pointermove", (event) => {
      const found = this.nearest(event);
      this.canvas.title = found ? pairWords(found) : "";
    });
  }

  /** The pair whose point is at the pointer. */
  nearest({ offsetX, offsetY }) {
    const far = (pair) => {
      const [x, y] = this.at(pair);
      return Math.hypot(x - offsetX, y - offsetY);
    };
    const [found] = [...this.pairs].sort((one, other) => far(one) - far(other));
    return found && far(found) < NEAR_PX ? found : null;
  }

  at({ in_s: inS, lost_in_s: lostInS, least_nm: nm }) {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    const { left, right, top, bottom } = MONITOR;
    const time = (lostInS ?? inS) / 60 / MONITOR.minutes;
    return [
      left + time * (width - left - right),
      height - bottom - (nm / MONITOR.nm) * (height - top - bottom),
    ];
  }

  /** What the radar shows at a row: recorded losses and, at the newest row, the conflicts that the
   *  session predicts; at older rows, what the page predicts as in a replay. */
  encounters(plane, scenario, row, limits) {
    const found = encountersAt(plane, scenario, row, limits);
    if (row !== scenario.cycles || this.cycle === null) return found;
    const byName = new Map(onRadar(scenario, row).map((each) => [each.callsign, each]));
    const lost = found.filter(({ kind }) => kind === "loss");
    const isLost = (pair) => lost.some((each) => each.pair.every((one) => pair.includes(one)));
    const conflicts = this.pairs.flatMap(({ callsigns, lost_in_s: lostInS, least_nm: nm, lost_at: at }) => {
      const pair = callsigns.map((each) => byName.get(each));
      const seconds = lostInS - (row - this.cycle) * this.cycleS;
      if (lostInS === null || pair.includes(undefined) || seconds < 0 || isLost(pair)) return [];
      const from = pair.map((each) => positionOf(each, row, 0));
      return { kind: "conflict", pair, from, at, seconds, text: `in ${minutes(seconds)}, min ${nmText(nm)}` };
    });
    return [...lost, ...conflicts.sort((one, other) => one.seconds - other.seconds)];
  }

  show({ cycle, pairs }) {
    this.cycle = cycle;
    const key = JSON.stringify([pairs, this.canvas.clientWidth, document.documentElement.dataset.theme]);
    if (key === this.drawn) return;
    this.drawn = key;
    this.pairs = pairs;
    this.draw();
    const lost = pairs.filter((each) => each.lost_in_s !== null);
    this.warn(lost.filter((each) => each.lost_in_s <= URGENT_S));
  }

  draw() {
    const { g, width, height, colour } = inkOf(this.canvas);
    const pen = { g, colour };
    g.fillStyle = colour.radar;
    g.fillRect(0, 0, width, height);
    const [left, bottom] = [MONITOR.left, height - MONITOR.bottom];
    stroke(pen, [[left, MONITOR.top], [left, bottom], [width - MONITOR.right, bottom]], colour.muted);
    const limit = this.at({ in_s: 0, lost_in_s: null, least_nm: this.limits.nm })[1];
    stroke(pen, [[left, limit], [width - MONITOR.right, limit]], colour.loss, { dash: [4, 4] });
    for (const each of [6, 12, 18]) {
      const [x] = this.at({ in_s: each * 60, lost_in_s: null, least_nm: 0 });
      write(pen, `${each} min`, x, height - 8, colour.muted, { align: each === 18 ? "right" : "center", size: 10 });
    }
    for (const nm of [5, 10, 15]) {
      const [, y] = this.at({ in_s: 0, lost_in_s: null, least_nm: nm });
      write(pen, String(nm), left - 4, y, colour.muted, { align: "right", size: 10 });
    }
    for (const pair of this.pairs) {
      const { lost_in_s: lostInS } = pair;
      const kind = lostInS === null ? undefined : lostInS <= URGENT_S ? "loss" : "conflict";
      drawSymbol(pen, this.at(pair), { kind, colour: colour[kind ?? "aircraft"], selected: false });
    }
  }

  /** A short tone for each pair that becomes urgent. */
  warn(urgent) {
    const now = new Set(urgent.map(({ callsigns }) => callsigns.join(" ")));
    const isNew = [...now].some((each) => !this.warned.has(each));
    this.warned = now;
    if (!isNew || !this.sound) return;
    const tone = this.sound.createOscillator();
    tone.frequency.value = 880;
    tone.connect(this.sound.destination);
    tone.start();
    tone.stop(this.sound.currentTime + 0.15);
  }
}

function pairWords({ callsigns, lost_in_s: lostInS, in_s: inS, least_nm: nm }) {
  const lost = lostInS === null ? "" : `separation lost in ${minutes(lostInS)}, `;
  return `${callsigns.join(" and ")}: ${lost}closest ${nmText(nm)} in ${minutes(inS)}`;
}
