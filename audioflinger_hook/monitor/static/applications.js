// Applications with a sound, and the rules that a person chooses for them.

const element = (kind, text = "", attributes = {}) => {
  const made = document.createElement(kind);
  made.textContent = text;
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  return made;
};
const titled = (word) => word[0].toUpperCase() + word.slice(1);

export class Applications {
  /** ask: sends a request to the daemon; tell: shows its answer. */
  constructor(place, ask, tell) {
    this.place = place;
    this.ask = ask;
    this.tell = tell;
    this.shown = "";
  }

  /** profiles: names for a rule; none if the daemon has no rules. */
  show(applications, profiles) {
    const state = JSON.stringify([applications, profiles]);
    if (state === this.shown) return; // else a key press on a button could be lost
    const focused = document.activeElement;
    if (focused?.tagName === "SELECT" && this.place.contains(focused)) return; // its list is open
    this.shown = state;
    const held = this.place.contains(focused) ? focused.dataset.application : "";
    const order = [...applications].sort((one, other) => other.plays - one.plays);
    this.place.replaceChildren(...order.map((one) => this.row(one, profiles)));
    if (!order.length) this.place.append(element("li", "No application plays sound.", { class: "none" }));
    if (held) this.place.querySelector(`[data-application="${CSS.escape(held)}"]`)?.focus();
  }

  row(application, profiles) {
    const { name, plays, is_felt: felt, rule } = application;
    const row = element("li"), title = element("span", name, { class: "name" });
    const why = rule ? ` (${rule})` : "";
    title.append(element("small", `${plays ? "plays" : "paused"}, ${felt ? "felt" : "left out"}${why}`));
    row.append(title);
    if (rule !== undefined && felt && profiles.length) row.append(this.menu(name, profiles));
    const button = element("button", felt ? "Leave out" : "Include", { type: "button", "data-application": name,
      "aria-label": `${felt ? "Leave out" : "Include"} ${name}` });
    button.onclick = () => this.choose(application, { feel: !felt });
    row.append(button);
    return row;
  }

  menu(name, profiles) {
    const menu = element("select", "", { "aria-label": `Profile of ${name}` });
    menu.append(element("option", "Profile …", { value: "" }), ...profiles.map((one) => element("option", titled(one), { value: one })));
    menu.onchange = () => {
      const profile = menu.value;
      menu.blur();
      if (profile) this.choose({ name, rule: "" }, { profile });
    };
    return menu;
  }

  /** Write a rule. A daemon without rules has its lists of included and excluded applications. */
  async choose({ name, rule }, values) {
    let answer = await this.ask({ application: { match: name, ...values } });
    if (answer.error && rule === undefined) answer = await this.ask({ application: name, felt: values.feel });
    this.tell(answer);
  }
}
