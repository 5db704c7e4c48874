// The options panel: vectors, trails and the level filter; and the search for a callsign.

class Options {
  constructor(player, display, changed) {
    const byId = (id) => document.getElementById(id);
    Object.assign(this, { player, display, changed });
    this.panel = byId("options");
    this.button = document.querySelector(".tools button[data-key='o']");
    [this.find, this.names] = [byId("find"), byId("callsigns")];
    [this.vector, this.trail] = [byId("vector"), byId("trail")];
    this.levels = [byId("from-fl"), byId("to-fl")];
    for (const each of VECTORS_MIN) this.vector.add(new Option(`${each} min`, String(each)));
    for (const [rows, name] of TRAILS) this.trail.add(new Option(name, String(rows)));
    this.listen();
    this.show();
  }

  listen() {
    const { display } = this;
    const on = (target, change) => {
      target.addEventListener("input", () => {
        change();
        this.changed();
      });
    };
    on(this.vector, () => (display.vectorMin = Number(this.vector.value)));
    on(this.trail, () => (display.trailRows = Number(this.trail.value)));
    for (const each of this.levels) {
      on(each, () => display.setLevels(...this.levels.map((input) => input.valueAsNumber)));
    }
    document.getElementById("all-levels").addEventListener("click", () => {
      for (const each of this.levels) each.value = "";
      display.setLevels(NaN, NaN);
      this.changed();
    });
    this.panel.addEventListener("keydown", (event) => {
      if (event.key !== "Escape") return;
      event.stopPropagation(); // it closes the panel, and does not clear the selection too
      this.close();
    });
    this.find.addEventListener("input", () => this.search(false));
    this.find.addEventListener("keydown", (event) => {
      if (event.key === "Enter") this.search(true);
      if (event.key === "Enter" || event.key === "Escape") this.find.blur();
      if (event.key === "Escape") this.find.value = "";
    });
  }

  /** Lists the callsigns of a scenario for the search. */
  open() {
    this.names.replaceChildren(...this.player.callsigns.map((each) => new Option(each, each)));
  }

  /** Selects the aircraft with the typed callsign or, if `any`, the first that contains it. */
  search(any) {
    const typed = this.find.value.trim().toLowerCase();
    const { callsigns } = this.player;
    const matches = (test) => callsigns.find((each) => test(each.toLowerCase()));
    const exact = matches((each) => each === typed);
    const begins = matches((each) => each.startsWith(typed));
    const contains = matches((each) => each.includes(typed));
    const callsign = exact ?? (any ? (begins ?? contains) : undefined);
    if (!typed) return;
    if (callsign !== undefined) this.player.select(callsign);
    else if (any) notify(`There is no aircraft ${this.find.value}.`);
  }

  /** Shows the settings in the panel and on the buttons. */
  show() {
    const { display } = this;
    this.vector.value = String(display.vectorMin);
    this.trail.value = String(display.trailRows);
    const pressed = { m: display.measuring, r: display.rings, g: display.profile };
    for (const [key, isOn] of Object.entries(pressed)) {
      for (const button of document.querySelectorAll(`button[data-key='${key}']`)) {
        button.setAttribute("aria-pressed", String(isOn));
      }
    }
    this.button.setAttribute("aria-expanded", String(!this.panel.hidden));
  }

  toggle() {
    if (this.close()) return;
    this.panel.hidden = false;
    this.show();
    this.vector.focus();
  }

  /** Whether the panel was open. */
  close() {
    const wasOpen = !this.panel.hidden;
    const hadFocus = this.panel.contains(document.activeElement);
    this.panel.hidden = true;
    this.show();
    if (wasOpen && hadFocus) this.button.focus();
    return wasOpen;
  }
}
