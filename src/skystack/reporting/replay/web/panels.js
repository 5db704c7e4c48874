// The panels next to a radar: title, count, strips, clearance log. Recorded text is never markup.

const STRIP_CLEARANCES = 12; // the latest ones; the log has all
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
  [null, ""], // not evaluated
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
    this.entries = scenario.clearances.map((issued) => this.entry(issued));
    this.log.replaceChildren(...this.entries.map((entry) => entry.item));
    if (!this.entries.length) this.log.append(element("li", "none", "No clearances."));
  }

  entry(issued) {
    const item = element("li");
    const button = element("button");
    const times = element("span", "times", issued.instructions > 1 ? `×${issued.instructions}` : "");
    times.title = counted(issued.instructions, "instruction");
    const time = element("time", "", minutes(issued.row * this.player.replay.cycle_s));
    const spoken = element("span", "unseen", `, ${counted(issued.instructions, "instruction")}`);
    button.append(time, element("span", "text", issued.text), times, spoken);
    times.setAttribute("aria-hidden", "true");
    button.addEventListener("click", () => {
      this.player.play(false);
      this.player.goTo(issued.row);
    });
    item.append(button);
    return { item, button };
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
    row.summary = cell("told");
    button.addEventListener("click", () => {
      const { player } = this;
      player.select(player.selected === aircraft.callsign ? null : aircraft.callsign);
    });
    item.append(button);
    return row;
  }

  /** Updates what changes from row to row. */
  show(row, encounters) {
    const issued = this.scenario.clearances.filter((each) => each.row <= row);
    const all = this.scenario.clearances.length;
    const instructions = issued.reduce((sum, each) => sum + each.instructions, 0);
    const number = element("strong", "", String(issued.length));
    const rest = ` of ${counted(all, "clearance")} (${counted(instructions, "instruction")})`;
    this.count.replaceChildren(number, rest);
    this.alerts.replaceChildren(...encounters.slice(0, ALERTS).map(alertOf));
    const more = encounters.length - ALERTS;
    if (more > 0) this.alerts.append(element("li", "", `and ${more} more`));
    for (const each of this.rows) this.showStrip(each, row, issued);
    this.showLog(issued.length);
  }

  showStrip({ aircraft, button, now, state, summary }, row, issued) {
    const last = Math.min(row, aircraft.rows - 1);
    const status = statusAt(aircraft, last).replaceAll("_", " ");
    const heading = threeDigits(aircraft.headingDeg[last]);
    const cleared = threeDigits(aircraft.clearedHeadingDeg[last]);
    const turn = heading === cleared ? `H${heading}` : `H${heading}→${cleared}`;
    const speed = `${Math.round(aircraft.speedKt[last])}\u00a0kt`;
    now.textContent = `FL${levelText(aircraft, last)} ${turn} ${speed}`;
    state.textContent = row >= aircraft.rows ? "off radar" : status;
    state.dataset.status = status;
    const own = issued.filter((each) => each.callsign === aircraft.callsign);
    const values = own.slice(-STRIP_CLEARANCES).map((each) => {
      const value = String(each.kind === "level" ? each.value : threeDigits(each.value));
      return `${each.kind === "level" ? "FL" : "H"}${value.padStart(3, "0")}`;
    });
    const more = own.length > STRIP_CLEARANCES ? "… " : "";
    summary.textContent = own.length
      ? `${own.length}: ${more}${values.join(" ")}`
      : "no clearances yet";
    button.setAttribute("aria-pressed", String(this.player.selected === aircraft.callsign));
  }

  /** Scrolls to the strip of the selected aircraft. */
  reveal(callsign) {
    const found = this.rows.find((row) => row.aircraft.callsign === callsign)?.item;
    const box = this.strips.parentElement;
    if (!found) return;
    const [top, end] = [found.offsetTop, found.offsetTop + found.offsetHeight];
    if (top < box.scrollTop || end > box.scrollTop + box.clientHeight) {
      box.scrollTop = top - box.clientHeight / 3;
    }
  }

  showLog(count) {
    this.entries.forEach(({ item, button }, number) => {
      item.classList.toggle("to-come", number >= count);
      if (number === count - 1) button.setAttribute("aria-current", "step");
      else button.removeAttribute("aria-current");
    });
    // Scroll the log only, not the page.
    const last = this.entries[count - 1]?.item;
    const box = this.log.parentElement;
    box.scrollTop = last ? last.offsetTop - box.clientHeight / 2 : 0;
  }
}

function alertOf({ kind, pair, text }) {
  const who = pair.map((aircraft) => aircraft.callsign).join(" and ");
  const what = kind === "loss" ? `loss of separation, ${text}` : `conflict ${text}`;
  return element("li", kind, `${who}: ${what}`);
}
