// Controls drawn from the schema of the config: label, range, unit, meaning, and the schema's own refusals.

const ORDER = ["device_volume_db", "drop_in", "engine", "damping", "protection", "exposure_cap"]; // the rest follows
const WORDS = { gain_db: ["Strength", "gentle", "full"], profile: ["Profile"], offset_ms: ["Delay", "at once", "later"] }; // label, ends of the slider
const NAMES = { "transform.strength": "Strength by frequency" }; // "Strength" is that of the vibration
const REASONS = {
  "declared by the sink": "as the output reports", "measured by cushion sync": "as you found it", "": "",
  "not known": "not known for this output",
};
const PROFILES = {
  cinema: "for films and series", game: "earlier, for games", music: "bass and rhythm", speech: "the syllables of voices",
  paper: "the published method, unchanged",
};
const UNITS = /_(db|ms|hz|s|frames)$/;
const PAUSE_MS = 60; // between two changes while a slider is moved

const element = (kind, attributes = {}, text = "") => {
  const made = document.createElement(kind);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  made.textContent = text;
  return made;
};

const titled = (word) => { const text = String(word); return text[0].toUpperCase() + text.slice(1); };

export class Controls {
  /** ask: sends a request to the daemon and resolves to its answer. all: place of controls without one of their own. */
  constructor(all, ask) {
    this.all = all;
    this.ask = ask;
    this.made = new Map();
  }

  show(settings) {
    const order = ({ key }) => (ORDER.includes(key) ? ORDER.indexOf(key) : ORDER.length);
    for (const key of [...settings.keys].sort((one, other) => order(one) - order(other))) {
      if (!this.made.has(key.key)) {
        const control = new Control(key, this.ask), own = document.querySelector(`[data-control="${key.key}"]`);
        this.made.set(key.key, control);
        if (own) {
          control.foot.append(...own.children);
          own.append(control.box);
        }
        else this.all.append(control.box);
      }
      this.made.get(key.key).show(key, settings.recording);
    }
  }

  /** The offset that is played, in ms, and where it comes from. */
  showOffset(ms, reason) {
    this.made.get("offset_ms")?.hint(ms, reason);
  }

  /** The labels of unsaved controls. */
  get unsaved() {
    return [...this.made.values()].filter(({ key }) => key.unsaved).map(({ name }) => name);
  }
}

class Control {
  constructor(key, ask) {
    this.key = key;
    this.ask = ask;
    this.wanted = undefined;
    this.busy = false;
    const id = `control-${key.key.replace(".", "-")}`, unit = UNITS.test(key.key) && !key.unit ? "" : key.unit;
    this.unit = unit;
    this.box = element("div", { class: "control" });
    const label = element("div", { class: "label" });
    const plain = key.key.split(".").pop().replace(UNITS, "").replaceAll("_", " ");
    const first = WORDS[key.key], [word, ...ends] = first ?? [NAMES[key.key] ?? titled(plain)];
    this.name = word;
    this.output = element("output");
    label.append(element("label", { for: id, id: `${id}-label` }, word), this.output);
    this.error = element("p", { class: "error", role: "alert", id: `${id}-error` });
    const foot = this.foot = element("div", { class: "foot" });
    this.isAuto = key.default === "auto" && key.schema.type === "number";
    this.reset = element("button", { type: "button", "aria-label": `${word}: ${this.isAuto ? "automatic" : "default"}` }, this.isAuto ? "Automatic" : "Default");
    this.reset.onclick = () => this.set(null);
    const technical = key.schema.enum || key.schema.type === "boolean" ? key.meaning : `${key.meaning}; ${key.allowed}`;
    this.meaning = element("p", { class: "meaning", title: key.change }, first ? "" : technical);
    foot.append(this.meaning, this.reset);
    this.filed = element("div", { class: "filed" });
    this.filed.hidden = true;
    const back = element("button", { type: "button", "aria-label": `${word}: as in the file` }, "Use that");
    back.onclick = () => this.set(this.key.file);
    this.filed.append(element("span"), back);
    this.box.append(label, this.input(id), foot, this.filed, this.error);
    if (first) this.simplify(label, ends);
  }

  /** A first control: its number is large and stands beside its label, and words stand at the slider's ends. */
  simplify(label, ends) {
    if (!ends.length) {
      this.output.replaceWith(this.meaning);
      return;
    }
    const number = element("span", { class: "number" }), [low, high] = ends.map((word) => element("span", { class: "unit", "aria-hidden": "true" }, word));
    number.append(this.exact, element("span", { class: "unit" }, this.unit));
    this.output.replaceWith(number);
    if (this.isAuto) this.exact.placeholder = "Automatic";
    this.field.before(low);
    this.field.after(high);
  }

  input(id) {
    const { schema } = this.key;
    if (schema.enum) return this.choices(id, schema.enum);
    if (schema.type === "boolean") {
      this.field = element("input", { type: "checkbox", id });
      this.field.onchange = () => this.set(this.field.checked);
      this.put = (value) => { this.field.checked = value === true; };
      return this.field;
    }
    if (schema.type === "number" || schema.type === "integer") return this.number(id, schema);
    this.field = element("input", { type: "text", id, placeholder: "none", autocomplete: "off" });
    this.field.onchange = () => this.set(this.field.value.split(",").map((one) => one.trim()).filter(Boolean));
    this.put = (value) => { this.field.value = (value ?? []).join(", "); };
    return this.field;
  }

  number(id, schema) {
    const row = element("div", { class: "row" }), span = schema.maximum - schema.minimum;
    const step = schema.type === "integer" ? 1 : span > 200 ? 1 : span > 20 ? 0.5 : Number((span / 200).toPrecision(1));
    const slider = element("input", { type: "range", id, step });
    this.limit = ({ minimum, maximum }) => { // what the other settings allow now, in whole steps
      slider.min = minimum === schema.minimum ? minimum : Number((Math.ceil(minimum / step - 1e-9) * step).toPrecision(6));
      slider.max = maximum === schema.maximum ? maximum : Number((Math.floor(maximum / step + 1e-9) * step).toPrecision(6));
    };
    this.limit(schema);
    const exact = this.exact = element("input", { type: "number", step: "any", "aria-labelledby": `${id}-label`, "aria-describedby": `${id}-error` });
    slider.oninput = () => { exact.value = slider.value; this.fill(); this.set(Number(slider.value)); };
    exact.onchange = () => this.set(exact.value === "" ? null : Number(exact.value));
    row.append(slider, exact);
    this.field = slider;
    this.put = (value) => { // a word such as "auto" stands for a number that the daemon chooses
      const isNumber = typeof value === "number";
      if (document.activeElement !== exact) exact.value = isNumber ? value : "";
      slider.value = isNumber ? value : value === null ? slider.max : 0;
      slider.dataset.unset = !isNumber;
      this.fill();
    };
    return row;
  }

  /** Colour the slider's track up to its thumb. */
  fill() {
    const { value, min, max, style } = this.field;
    style.setProperty("--fill", `${(100 * (value - min)) / (max - min)}%`);
  }

  choices(id, words) {
    if (words.length > 5) {
      this.field = element("select", { id });
      this.field.append(...words.map((word) => element("option", { value: word }, word)));
      this.field.onchange = () => this.set(typeof words[0] === "number" ? Number(this.field.value) : this.field.value);
      this.put = (value) => { this.field.value = value; };
      return this.field;
    }
    const group = element("div", { class: "choices", role: "radiogroup", "aria-labelledby": `${id}-label` });
    if (this.key.key === "profile") words = Object.keys(PROFILES).filter((word) => words.includes(word)).concat(words.filter((word) => !(word in PROFILES)));
    const inputs = words.map((word, index) => {
      const label = element("label"), input = element("input", { type: "radio", name: id, value: word });
      if (!index) input.id = id;
      input.onchange = () => this.set(word);
      label.append(input, element("span", {}, titled(word)));
      group.append(label);
      return input;
    });
    this.put = (value) => inputs.forEach((input) => { input.checked = input.value === String(value); });
    this.limit = ({ enum: allowed }) => inputs.forEach((input) => { input.closest("label").hidden = !allowed.map(String).includes(input.value); });
    return group;
  }

  show(key, recording) {
    this.key = key;
    this.box.dataset.unsaved = key.unsaved;
    this.filed.hidden = !key.unsaved;
    const filed = key.file ?? key.default;
    this.filed.firstChild.textContent = `Not saved. In the file: ${filed === null ? "nothing" : this.worded(filed)}`;
    this.reset.disabled = JSON.stringify(key.value) === JSON.stringify(key.default);
    if (this.busy || this.wanted !== undefined) return; // a change of our own is under way
    this.limit?.(key.schema);
    this.put(key.value);
    this.tell(key.value);
    this.box.querySelectorAll("input, select").forEach((field) => { field.disabled = recording; });
  }

  hint(ms, reason) {
    const isAuto = typeof this.key.value !== "number";
    this.meaning.textContent = isAuto && reason ? `${reason === "not known" ? "Delay" : `${ms.toFixed(0)} ms`} ${REASONS[reason] ?? reason}` : "";
    if (!isAuto || this.busy) return;
    this.field.value = ms;
    this.fill();
  }

  worded(value) {
    const isNumber = typeof value === "number";
    const shown = isNumber ? Number(value.toPrecision(6)) : value === true ? "on" : value === false ? "off" : Array.isArray(value) ? value.join(", ") || "none" : titled(String(value));
    return value === "auto" && this.isAuto ? "Automatic" : `${shown} ${isNumber ? this.unit : ""}`.trim();
  }

  tell(value) {
    this.output.textContent = value === null ? "not set" : Array.isArray(value) ? "" : this.worded(value);
    if (this.key.key === "profile") this.meaning.textContent = PROFILES[value] ?? "";
    if (this.field?.type === "range") this.field.setAttribute("aria-valuetext", this.output.textContent);
  }

  /** Ask for a value; while one is under way only the newest waits. */
  async set(value) {
    this.wanted = value;
    this.tell(value);
    if (this.busy) return;
    this.busy = true;
    let answer = {};
    while (this.wanted !== undefined) {
      const next = this.wanted;
      this.wanted = undefined;
      answer = await this.ask({ set: { [this.key.key]: next } });
      await new Promise((resume) => setTimeout(resume, PAUSE_MS));
    }
    this.busy = false;
    this.error.textContent = answer.error ?? "";
    this.box.dataset.bad = Boolean(answer.error);
    if (answer.error) this.show(this.key, false);
  }
}
