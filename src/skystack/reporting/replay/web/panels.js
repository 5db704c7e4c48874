// The panels next to a radar: title, verdict, count, strips, log. Recorded text is never markup.

const STRIP_CLEARANCES = 12; // the latest ones; the log has all
const KEPT_ROWS = 20; // in arriving traffic, the strip of an aircraft that has left stays for two minutes

function element(tag, className = "", text = "") {
  const made = document.createElement(tag);
  if (className) made.className = className;
  made.textContent = text;
  return made;
}

const REASONS = new Map([
  ["excursion", "excursion"],
  ["wrong_exit_level", "wrong exit level"],
  ["not_exited", "not exited"],
  ["too_many_clearances", "too many clearances"],
]);
const NAMED = 3; // aircraft per reason

/** Why a scenario failed, as far as the tables tell, with the aircraft. */
function reasonsOf({ failures, aircraft }) {
  return failures.map(({ reason, aircraft: indices }) => {
    const names = indices.slice(0, NAMED).map((index) => aircraft[index].callsign);
    if (indices.length > NAMED) names.push(`${indices.length - NAMED} more`);
    const who = names.length ? ` (${names.join(", ")})` : "";
    return `${REASONS.get(reason) ?? reason}${who}`;
  });
}

function verdictOf(scenario) {
  const lost = scenario.losses.length > 0;
  if (scenario.success === null) {
    // Not evaluated, or an hour of arriving traffic.
    return [...reasonsOf(scenario), ...(lost ? ["separation lost"] : [])].join("; ");
  }
  if (scenario.success) return lost ? "success, but separation lost" : "success";
  const reasons = reasonsOf(scenario).join(", ");
  return `failed${reasons && `: ${reasons}`}${lost ? "; separation lost" : ""}`;
}

class Panels {
  constructor(pane, title, player) {
    const part = (selector) => pane.querySelector(selector);
    this.player = player;
    this.count = part(".count");
    this.strips = part(".strips ul");
    this.log = part(".log ol");
    this.verdict = part(".verdict");
    this.notes = { measured: part(".measured"), levels: part(".levels-shown") };
    part("h2").textContent = title;
    part(".side").dataset.title = title;
    part(".scope canvas").setAttribute("aria-label", `Radar: ${title}`);
  }

  open(scenario) {
    this.scenario = scenario;
    [this.rows, this.entries] = [[], []];
    this.strips.replaceChildren();
    this.log.replaceChildren(element("li", "none", "No clearances."));
    this.grow();
  }

  /** Adds the aircraft and the clearances that the scenario has gained. */
  grow() {
    const { success, losses, failures, aircraft, transmissions } = this.scenario;
    this.verdict.textContent = verdictOf(this.scenario);
    this.verdict.dataset.good = success !== false && !losses.length && !failures.length;
    const rows = aircraft.slice(this.rows.length).map((each) => this.strip(each));
    this.rows.push(...rows);
    this.strips.append(...rows.map((row) => row.item));
    const entries = transmissions.slice(this.entries.length).map((issued) => this.entry(issued));
    if (entries.length && !this.entries.length) this.log.replaceChildren();
    this.entries.push(...entries);
    this.log.append(...entries.map((entry) => entry.item));
    this.shown = null; // the number of clearances in the log that have been issued
  }

  entry(issued) {
    const item = element("li");
    const button = element("button");
    const stacked = issued.instructions > 1 ? counted(issued.instructions, "instruction") : "";
    // The new cleared value is shown from `row`, one cycle after the clearance was issued.
    const time = element("time", "", minutes((issued.row - 1) * this.player.replay.cycle_s));
    button.append(time, element("span", "text", issued.text), element("span", "stacked", stacked));
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
    row.exit = cell("exit");
    row.exit.classList.toggle("known", aircraft.exitOffsetNm !== null);
    row.summary = cell("clearance");
    button.addEventListener("click", (event) => this.player.pick(aircraft.callsign, event.shiftKey));
    item.append(button);
    return row;
  }

  /** Updates what changes from row to row; `isShown` tells which aircraft are on the radar. */
  show(row, isShown) {
    const issued = this.scenario.clearances.filter((each) => each.row <= row);
    const count = this.scenario.transmissions.filter((each) => each.row <= row).length;
    const all = this.scenario.transmissions.length;
    const instructions = issued.reduce((sum, each) => sum + each.instructions, 0);
    const number = element("strong", "", String(count));
    const detail = element("span", "detail", ` (${counted(instructions, "instruction")})`);
    this.count.replaceChildren(number, ` of ${counted(all, "clearance")}`, detail);
    const own = new Map(this.scenario.aircraft.map(({ callsign }) => [callsign, []]));
    for (const each of issued) own.get(each.callsign).push(each);
    for (const each of this.rows) {
      each.item.hidden = this.scenario.hasArrivals && !this.isAbout(each.aircraft, row);
      if (each.item.hidden) continue;
      this.showStrip(each, row, own.get(each.aircraft.callsign));
      each.item.classList.toggle("hidden-level", !isShown(each.aircraft));
    }
    this.showLog(count);
  }

  /** Writes the measured line and the level filter over the radar. */
  note(line, display, flying, shown) {
    const band = `FL${display.fromFl} to FL${display.toFl} only: ${shown} of ${flying} aircraft`;
    // While the replay runs, the values would be read out all the time.
    this.notes.measured.setAttribute("aria-live", this.player.isMoving ? "off" : "polite");
    setText(this.notes.measured, line ? measureWords(line) : "");
    setText(this.notes.levels, display.isFiltered ? band : "");
  }

  /** Whether an aircraft has a strip in arriving traffic: it is on the radar, has just left it, or has
   *  appeared and is selected. */
  isAbout(aircraft, row) {
    const isRecent = aircraft.begins <= row && row < aircraft.rows + KEPT_ROWS;
    return isRecent || (this.player.isSelected(aircraft.callsign) && aircraft.begins <= row);
  }

  showStrip({ aircraft, button, now, state, exit, summary }, row, own) {
    const last = Math.min(row, aircraft.rows - 1);
    const status = statusAt(aircraft, last).replaceAll("_", " ");
    const heading = threeDigits(aircraft.headingDeg[last]);
    const cleared = threeDigits(aircraft.clearedHeadingDeg[last]);
    const turn = heading === cleared ? `H${heading}` : `H${heading}→${cleared}`;
    const speed = `${Math.round(aircraft.speedKt[last])}\u00a0kt`;
    setText(now, `FL${levelText(aircraft, last)} ${turn} ${speed}`);
    setText(state, row >= aircraft.rows && status !== "exited" ? "off radar" : status);
    state.dataset.status = status;
    const offset = status === "exited" ? aircraft.exitOffsetNm : null;
    const fix = "its exit fix";
    setText(exit, offset === null ? "" : `exit ${offset.toFixed(1)}\u00a0NM from ${fix}`);
    const values = own.slice(-STRIP_CLEARANCES).map((each) => {
      if (each.kind === "direct") return aircraft.route[each.value] ?? "direct";
      const value = String(each.kind === "level" ? each.value : threeDigits(each.value));
      return `${each.kind === "level" ? "FL" : "H"}${value.padStart(3, "0")}`;
    });
    const more = own.length > STRIP_CLEARANCES ? "… " : "";
    const count = new Set(own.map((each) => each.row)).size;
    const text = own.length ? `${count}: ${more}${values.join(" ")}` : "no clearances yet";
    setText(summary, text);
    button.setAttribute("aria-pressed", String(this.player.isSelected(aircraft.callsign)));
  }

  /** Scrolls to the strip of the selected aircraft. */
  reveal(callsign) {
    const found = this.rows.find((row) => row.aircraft.callsign === callsign)?.item;
    if (found) scrollInto(this.strips.parentElement, found);
  }

  showLog(count) {
    if (count === this.shown) return;
    this.shown = count;
    this.entries.forEach(({ item, button }, number) => {
      item.classList.toggle("to-come", number >= count);
      if (number === count - 1) button.setAttribute("aria-current", "step");
      else button.removeAttribute("aria-current");
    });
    const box = this.log.parentElement;
    const last = this.entries[count - 1]?.item;
    if (last) scrollInto(box, last);
    else box.scrollTop = 0;
  }
}

const STICKY_PX = 32; // the heading that stays at the top of a list

/** Scrolls a box, not the page, until an item in it is visible. */
function scrollInto(box, item) {
  if (box.scrollHeight <= box.clientHeight) return;
  const [top, end] = [item.offsetTop, item.offsetTop + item.offsetHeight];
  if (top - STICKY_PX < box.scrollTop || end > box.scrollTop + box.clientHeight) {
    box.scrollTop = top - box.clientHeight / 2;
  }
}

/** Changes a text only if it differs, which costs no layout otherwise. */
function setText(target, text) {
  if (target.textContent !== text) target.textContent = text;
}
