// Controls drawn from the schema of the config: label, range, unit, meaning, and the schema's own refusals.

import { element, fill, newest, PROFILES, titled } from "./elements.js";

const ORDER = ["device_volume_db", "drop_in", "engine", "damping", "protection", "exposure_cap"]; // the rest follows
const WORDS = { gain_db: ["Strength", "gentle", "full"], profile: ["Profile"], offset_ms: ["Delay", "at once", "later"] }; // label, ends of the slider
const NAMES = { "transform.strength": "Strength by frequency" }; // "Strength" is that of the vibration
const REASONS = {
  "declared by the sink": "as the output reports", "measured by cushion sync": "as you found it", "": "",
  "not known": "not known for this output",
};
/** Names of profiles: those above first, in their order. */
export const ordered = (names) => [...new Set([...Object.keys(PROFILES).filter((one) => names.includes(one)), ...names])];
const UNITS = /_(db|ms|hz|s|frames)$/;
const PAUSE_MS = 60; // between two changes while a slider is moved

export class Controls {
  /** ask: sends a request to the daemon and resolves to its answer. all: place of controls without one of their own. */
  constructor(all, ask) {
    Object.assign(this, { all, ask, made: new Map() });
  }

  show(settings) {
    const order = ({ key }) => (ORDER.includes(key) ? ORDER.indexOf(key) : ORDER.length);
    for (const key of [...settings.keys].sort((one, other) => order(one) - order(other))) {
      if (!this.made.has(key.key)) this.make(key);
      this.made.get(key.key).show(key, settings.recording);
    }
  }

  make(key) {
    const control = new Control(key, this.ask), own = document.querySelector(`[data-control="${key.key}"]`);
    this.made.set(key.key, control);
    control.foot.append(...own?.children ?? []);
    (own ?? this.all).append(control.box);
  }

  /** The offset that is played, in ms, and where it comes from. */
  showOffset(ms, reason) {
    this.made.get("offset_ms")?.hint(ms, reason);
  }

  /** Whether the newest value of a control has still to be sent. */
  get busy() {
    return [...this.made.values()].some(({ send }) => send.busy);
  }

  /** The labels of unsaved controls. */
  get unsaved() {
    return [...this.made.values()].filter(({ key }) => key.unsaved).map(({ name }) => name);
  }
}

class Control {
  constructor(key, ask) {
    this.key = key;
    this.unit = key.unit;
    this.isAuto = key.default === "auto" && key.schema.type === "number";
    const id = `control-${key.key.replace(".", "-")}`, first = WORDS[key.key];
    const plain = key.key.split(".").pop().replace(UNITS, "").replaceAll("_", " ");
    const [word, ...ends] = first ?? [NAMES[key.key] ?? titled(plain)];
    this.name = word;
    this.output = element("output");
    const label = element("div", { class: "label" }, element("label", { for: id, id: `${id}-label` }, word), this.output);
    this.error = element("p", { class: "error", role: "alert", id: `${id}-error` });
    const technical = key.schema.enum || key.schema.type === "boolean" ? key.meaning : `${key.meaning}; ${key.allowed}`;
    this.meaning = element("p", { class: "meaning", title: key.change }, first ? "" : technical);
    const back = this.isAuto ? "Automatic" : "Default";
    this.reset = this.button(back, `${word}: ${back.toLowerCase()}`, () => null);
    this.foot = element("div", { class: "foot" }, this.meaning, this.reset);
    const use = this.button("Use that", `${word}: as in the file`, () => this.key.file);
    this.filed = element("div", { class: "filed", hidden: "" }, element("span"), use);
    this.box = element("div", { class: "control" }, label, this.input(id), this.foot, this.filed, this.error);
    if (first) this.simplify(ends);
    this.send = newest(async (value) => {
      const { error = "" } = await ask({ set: { [key.key]: value } });
      await new Promise((resume) => setTimeout(resume, PAUSE_MS));
      this.error.textContent = error;
      this.box.dataset.bad = Boolean(error);
      if (!error) this.exact?.onblur(); // a refused number stays until it is corrected
      if (error || value === null) this.display();
    });
  }

  button(text, label, value) {
    const button = element("button", { type: "button", "aria-label": label }, text);
    button.onclick = () => {
      if (value() !== null) this.put(value());
      this.set(value());
    };
    return button;
  }

  /** A first control: its number is large and stands beside its label, and words stand at the slider's ends. */
  simplify(ends) {
    if (!ends.length) {
      this.output.replaceWith(this.meaning);
      return;
    }
    const [low, high] = ends.map((word) => element("span", { class: "unit", "aria-hidden": "true" }, word));
    this.output.replaceWith(element("span", { class: "number" }, this.exact, element("span", { class: "unit" }, this.unit)));
    if (this.isAuto) this.exact.placeholder = "Automatic";
    this.field.before(low);
    this.field.after(high);
  }

  /** Make the field. `put` shows a value in it, and `limit` the values that the other settings allow now. */
  input(id) {
    const { schema } = this.key;
    if (schema.enum) return this.choices(id, schema.enum);
    if (schema.type === "number" || schema.type === "integer") return this.number(id, schema);
    const isSwitch = schema.type === "boolean", field = this.field = element("input", { type: isSwitch ? "checkbox" : "text", id });
    if (isSwitch) {
      field.onchange = () => this.set(field.checked);
      this.put = (value) => { field.checked = value === true; };
      return field;
    }
    [field.placeholder, field.autocomplete] = ["none", "off"];
    field.onchange = () => this.set(field.value.split(",").map((one) => one.trim()).filter(Boolean));
    this.put = (value) => { field.value = (value ?? []).join(", "); };
    return field;
  }

  number(id, schema) {
    const span = schema.maximum - schema.minimum;
    const step = schema.type === "integer" ? 1 : span > 200 ? 1 : span > 20 ? 0.5 : Number((span / 200).toPrecision(1));
    const slider = this.field = element("input", { type: "range", id, step });
    const whole = (round, limit, end) => (limit === end ? limit : Number((round(limit / step) * step).toPrecision(6)));
    this.limit = ({ minimum, maximum }) => {
      slider.min = whole((steps) => Math.ceil(steps - 1e-9), minimum, schema.minimum);
      slider.max = whole((steps) => Math.floor(steps + 1e-9), maximum, schema.maximum);
    };
    this.limit(schema);
    const exact = this.exact = element("input", { type: "number", step: "any", "aria-labelledby": `${id}-label`, "aria-describedby": `${id}-error` });
    slider.oninput = () => { exact.value = slider.value; fill(slider); this.set(Number(slider.value)); };
    exact.oninput = () => { exact.dataset.typed = true; };
    exact.onblur = () => { delete exact.dataset.typed; };
    exact.onchange = () => this.set(exact.value === "" ? null : Number(exact.value));
    this.put = (value) => { // a word such as "auto" stands for a number that the daemon chooses
      const isNumber = typeof value === "number";
      if (!exact.dataset.typed) exact.value = isNumber ? value : "";
      slider.value = isNumber ? value : value === null ? slider.max : 0;
      slider.dataset.unset = !isNumber;
      fill(slider);
    };
    return element("div", { class: "row" }, slider, exact);
  }

  choices(id, words) {
    if (this.key.key === "profile") words = ordered(words);
    const inputs = words.map((word, index) => {
      const input = element("input", { type: "radio", name: id, value: word, ...(index ? {} : { id }) });
      input.onchange = () => this.set(word);
      return input;
    });
    this.put = (value) => inputs.forEach((input) => { input.checked = input.value === `${value}`; });
    this.limit = ({ enum: allowed }) => inputs.forEach((input) => { input.parentElement.hidden = !allowed.map(String).includes(input.value); });
    return element("div", { class: "choices", role: "radiogroup", "aria-labelledby": `${id}-label` },
      ...inputs.map((input) => element("label", {}, input, element("span", {}, titled(input.value)))));
  }

  show(key, recording) {
    this.key = key;
    this.box.dataset.unsaved = key.unsaved;
    this.filed.hidden = !key.unsaved;
    const filed = key.file ?? key.default;
    this.filed.firstChild.textContent = `Not saved. In the file: ${filed === null ? "nothing" : this.worded(filed)}`;
    this.reset.disabled = JSON.stringify(key.value) === JSON.stringify(key.default);
    if (!this.send.busy) this.display(); // else a change of our own is under way
    this.box.querySelectorAll("input, select").forEach((field) => { field.disabled = recording; });
  }

  display() {
    this.limit?.(this.key.schema);
    this.put(this.key.value);
    this.tell(this.key.value);
  }

  hint(ms, reason) {
    const isAuto = typeof this.key.value !== "number";
    this.meaning.textContent = isAuto && reason ? `${reason === "not known" ? "Delay" : `${ms.toFixed(0)} ms`} ${REASONS[reason] ?? reason}` : "";
    if (!isAuto || this.send.busy) return;
    this.field.value = ms;
    fill(this.field);
  }

  worded(value) {
    if (typeof value === "number") return `${Number(value.toPrecision(6))} ${this.unit}`.trim();
    if (typeof value === "boolean") return value ? "on" : "off";
    if (Array.isArray(value)) return value.join(", ") || "none";
    return value === "auto" && this.isAuto ? "Automatic" : titled(value);
  }

  tell(value) {
    this.output.textContent = value === null ? "not set" : Array.isArray(value) ? "" : this.worded(value);
    if (this.key.key === "profile") this.meaning.textContent = PROFILES[value] ?? "";
    if (this.field?.type === "range") this.field.setAttribute("aria-valuetext", this.output.textContent);
  }

  set(value) {
    this.tell(value);
    this.send(value);
  }
}
