// The conflicts and losses of separation of a run: the present ones, and all recorded losses.

function symbolOf(kind) {
  const svg = mark("svg", { class: "symbol", viewBox: "0 0 16 16", "aria-hidden": "true" });
  svg.append(mark("use", { href: `#${kind}` }));
  return svg;
}

class Alerts {
  /** `goTo(pair, row)` selects a pair of callsigns, and goes to the row unless it is undefined. */
  constructor(pane, player, goTo) {
    const part = (selector) => pane.querySelector(selector);
    [this.player, this.goTo] = [player, goTo];
    this.list = part(".alerts");
    this.number = part(".alerts-box .number");
    this.box = part(".encounters");
    this.section = part(".losses");
    this.losses = part(".losses ol");
    this.known = [];
  }

  /** Lists all losses of separation of the scenario. */
  open(scenario) {
    const { cycle_s: cycleS } = this.player.replay;
    this.box.hidden = scenario.aircraft.length < 2;
    this.section.hidden = !scenario.losses.length;
    const inOrder = [...scenario.losses].sort((one, other) => one.begins - other.begins);
    this.losses.replaceChildren(
      ...inOrder.map((loss) => {
        const pair = [loss.first, loss.second].map((index) => scenario.aircraft[index].callsign);
        const { item, button, text } = this.entry("loss", pair, loss.begins + 1);
        button.insertBefore(element("time", "", minutes((loss.begins + 1) * cycleS)), text);
        text.textContent = `${pair.join(" and ")}, min ${nmText(loss.least_nm)}`;
        return item;
      }),
    );
  }

  entry(kind, pair, row) {
    const item = element("li", kind);
    const button = element("button");
    const text = element("span");
    button.append(symbolOf(kind), text);
    button.addEventListener("click", () => this.goTo(pair, row));
    item.append(button);
    return { item, button, text };
  }

  /** Lists the present conflicts and losses. Entries that stay keep the focus. */
  show(encounters) {
    const wanted = encounters.map((each) => {
      const pair = each.pair.map((aircraft) => aircraft.callsign);
      return { pair, kind: each.kind, key: JSON.stringify([each.kind, pair]), words: wordsOf(each) };
    });
    const before = new Map(this.known.map((each) => [each.key, each]));
    const isSame =
      wanted.length === this.known.length &&
      wanted.every(({ key }, index) => key === this.known[index].key);
    this.known = wanted.map(({ key, kind, pair, words }) => {
      const made = before.get(key) ?? { key, ...this.entry(kind, pair) };
      if (made.text.textContent !== words) made.text.textContent = words;
      return made;
    });
    if (isSame) return;
    const focused = document.activeElement;
    this.list.replaceChildren(...this.known.map(({ item }) => item));
    if (this.list.contains(focused)) focused.focus({ preventScroll: true });
    this.number.textContent = encounters.length ? ` (${encounters.length})` : "";
  }
}

function wordsOf({ kind, pair, text }) {
  const who = pair.map((aircraft) => aircraft.callsign).join(" and ");
  return `${who}: ${kind === "loss" ? `loss of separation, ${text}` : `conflict ${text}`}`;
}
