// What stands beside a radar: title and count, strips, the log of clearances. Text, never markup.

const SAID_LAST = 12; // clearances on a strip; the log has all
const ALERTS = 6;

function element(tag, className = "", text = "") {
  const made = document.createElement(tag);
  if (className) made.className = className;
  made.textContent = text;
  return made;
}

const VERDICTS = new Map([
  [true, "success"],
  [false, "no success"],
  [null, ""], // nobody judged it
]);

class Panels {
  constructor(pane, title, player) {
    const part = (selector) => pane.querySelector(selector);
    this.player = player;
    this.count = part(".count");
    this.alerts = part(".alerts");
    this.strips = part(".strips ul");
    this.log = part(".log ol");
    this.verdict = part(".verdict");
    part("h2").textContent = title;
    part(".beside").dataset.title = title;
    part("canvas").setAttribute("aria-label", `Radar: ${title}`);
  }

  open(scenario) {
    this.scenario = scenario;
    const lost = scenario.losses.length > 0;
    const verdict = [VERDICTS.get(scenario.success), lost ? "separation lost" : ""];
    this.verdict.textContent = verdict.filter(Boolean).join(", ");
    this.verdict.dataset.good = scenario.success !== false && !lost;
    this.rows = scenario.aircraft.map((aircraft) => this.strip(aircraft));
    this.strips.replaceChildren(...this.rows.map((row) => row.item));
    this.entries = scenario.clearances.map((said) => this.entry(said));
    this.log.replaceChildren(...this.entries.map((entry) => entry.item));
    if (!this.entries.length) this.log.append(element("li", "none", "Nothing is said."));
  }

  entry(said) {
    const item = element("li");
    const button = element("button");
    const times = element("span", "times", said.instructions > 1 ? `×${said.instructions}` : "");
    times.title = counted(said.instructions, "instruction");
    const time = element("time", "", minutes(said.row * this.player.replay.cycle_s));
    const spoken = element("span", "unseen", `, ${counted(said.instructions, "instruction")}`);
    button.append(time, element("span", "text", said.text), times, spoken);
    times.setAttribute("aria-hidden", "true");
    button.addEventListener("click", () => {
      this.player.play(false);
      this.player.goTo(said.row);
    });
    item.append(button);
    return { item, button, said };
  }

  strip(aircraft) {
    const item = element("li");
    const button = element("button", "strip");
    const cell = (name) => button.appendChild(element("span", name));
    cell("callsign").textContent = aircraft.callsign;
    cell("type").textContent = aircraft.type;
    const row = { item, button, aircraft, now: cell("now"), state: cell("state") };
    const entryFl = Math.round(aircraft.entryFl);
    cell("levels").textContent = `in ${entryFl}, out ${aircraft.exitFl}`;
    cell("route").textContent = aircraft.route.join(" ");
    row.told = cell("told");
    button.addEventListener("click", () => {
      const { player } = this;
      player.select(player.selected === aircraft.callsign ? null : aircraft.callsign);
    });
    item.append(button);
    return row;
  }

  /** What changes from row to row. */
  show(row, met) {
    const said = this.scenario.clearances.filter((each) => each.row <= row);
    const all = this.scenario.clearances.length;
    const given = said.reduce((sum, each) => sum + each.instructions, 0);
    const number = element("strong", "", String(said.length));
    const rest = ` of ${counted(all, "clearance")}, from ${counted(given, "instruction")}`;
    this.count.replaceChildren(number, rest);
    this.alerts.replaceChildren(...met.slice(0, ALERTS).map(alertOf));
    if (met.length > ALERTS) this.alerts.append(element("li", "", `and ${met.length - ALERTS} more`));
    for (const each of this.rows) this.showStrip(each, row, said);
    this.showLog(said.length);
  }

  showStrip({ aircraft, button, now, state, told }, row, said) {
    const seen = Math.min(row, aircraft.rows - 1);
    const status = statusAt(aircraft, seen).replaceAll("_", " ");
    const heading = threeDigits(aircraft.headingDeg[seen]);
    const cleared = threeDigits(aircraft.clearedHeadingDeg[seen]);
    const turn = heading === cleared ? `H${heading}` : `H${heading}→${cleared}`;
    const speed = `${Math.round(aircraft.speedKt[seen])}\u00a0kt`;
    now.textContent = `FL${levelText(aircraft, seen)} ${turn} ${speed}`;
    state.textContent = row >= aircraft.rows ? "gone" : status;
    state.dataset.status = status;
    const own = said.filter((each) => each.callsign === aircraft.callsign);
    const values = own.slice(-SAID_LAST).map((each) => {
      const value = String(each.kind === "level" ? each.value : threeDigits(each.value));
      return `${each.kind === "level" ? "FL" : "H"}${value.padStart(3, "0")}`;
    });
    const more = own.length > SAID_LAST ? "… " : "";
    told.textContent = own.length ? `${own.length}: ${more}${values.join(" ")}` : "nothing said yet";
    button.setAttribute("aria-pressed", String(this.player.selected === aircraft.callsign));
  }

  /** Scroll to the strip of the selected aircraft, where there are many. */
  reveal(callsign) {
    const found = this.rows.find((row) => row.aircraft.callsign === callsign)?.item;
    const box = this.strips.parentElement;
    if (!found) return;
    const [top, end] = [found.offsetTop, found.offsetTop + found.offsetHeight];
    if (top < box.scrollTop || end > box.scrollTop + box.clientHeight) {
      box.scrollTop = top - box.clientHeight / 3;
    }
  }

  showLog(said) {
    this.entries.forEach(({ item, button }, number) => {
      item.classList.toggle("to-come", number >= said);
      if (number === said - 1) button.setAttribute("aria-current", "step");
      else button.removeAttribute("aria-current");
    });
    // Its own scrolling only: the page must not move under the reader.
    const last = this.entries[said - 1]?.item;
    const box = this.log.parentElement;
    box.scrollTop = last ? last.offsetTop - box.clientHeight / 2 : 0;
  }
}

function alertOf({ kind, pair, text }) {
  const who = pair.map((aircraft) => aircraft.callsign).join(" and ");
  const what = kind === "loss" ? `loss of separation, ${text}` : text;
  return element("li", kind, `${who}: ${what}`);
}
