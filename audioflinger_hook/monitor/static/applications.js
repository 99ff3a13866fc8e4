// Applications with a sound, and the rules that a person chooses for them.

import { ordered } from "./controls.js";
import { element, titled } from "./elements.js";

/** The rule that matches a name. A [ without a ] stands for itself only as [[]. */
const matchOf = (name) => (name.includes(":") ? "application:" : "") + (/\[.+\]/s.test(name) ? name : name.replaceAll("[", "[[]"));
export const nameOf = (match) => match.replace(/^application:/, "").replaceAll("[[]", "[");
const same = (one, other) => one.trim().toLowerCase() === other.trim().toLowerCase();

export class Applications {
  /** choose: changes the rule of an application, called with {match, feel} or {match, profile}. */
  constructor(place, choose) {
    Object.assign(this, { place, choose, shown: "" });
  }

  /** rules, unsaved_rules: of the settings. profiles: names for a rule. */
  show(applications, { rules = [], unsaved_rules: unsaved = [] }, profiles) {
    const state = JSON.stringify([applications, rules, unsaved, profiles]);
    if (state === this.shown) return; // else a key press on a button could be lost
    if (this.place.querySelector("[data-used]:focus")) return; // the menu's list may be open
    this.shown = state;
    const held = this.place.querySelector(":focus");
    const order = [...applications].sort((one, other) => other.plays - one.plays);
    this.place.replaceChildren(...order.map((one) => {
      const match = matchOf(one.name), rule = rules.find((rule) => same(rule.match, match)) ?? {};
      return this.row(one, match, rule, unsaved.some((name) => same(name, match)), profiles);
    }));
    if (!order.length) this.place.append(element("li", { class: "none" }, "No application plays sound."));
    if (held) this.place.querySelector(`${held.tagName}[data-application="${CSS.escape(held.dataset.application)}"]`)?.focus();
  }

  row({ name, plays, is_felt: felt, rule: why }, match, rule, isUnsaved, profiles) {
    const state = `${plays ? "plays" : "paused"}, ${felt ? "felt" : "left out"}${why ? ` (${why})` : ""}${isUnsaved ? ", not saved" : ""}`;
    const row = element("li", {}, element("span", { class: "name" }, name, element("small", {}, state)));
    if (felt && profiles.length) row.append(this.menu(name, match, rule.profile ?? "", profiles));
    const word = felt ? "Leave out" : "Include";
    const button = element("button", { type: "button", "data-application": name, "aria-label": `${word} ${name}` }, word);
    button.onclick = () => this.choose({ match, feel: !felt });
    row.append(button);
    return row;
  }

  menu(name, match, profile, profiles) {
    const menu = element("select", { "data-application": name, "aria-label": `Profile of ${name}` }, element("option", { value: "" }, "Usual profile"),
      ...ordered(profiles).map((one) => element("option", { value: one }, titled(one))));
    menu.value = profile;
    menu.onpointerdown = menu.onkeydown = () => { menu.dataset.used = ""; };
    menu.onchange = () => {
      delete menu.dataset.used;
      this.choose({ match, profile: menu.value || null });
    };
    return menu;
  }
}
