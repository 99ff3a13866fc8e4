// Controls drawn from the schema of the config: label, range, unit, meaning, and the schema's own refusals.

const FIRST = ["gain_db", "profile", "offset_ms", "engine", "damping", "device_volume_db", "protection", "exposure_cap"];
const UNITS = /_(db|ms|hz|s|frames)$/;
const PAUSE_MS = 60; // between two changes while a slider is moved

const element = (kind, attributes = {}, text = "") => {
  const made = document.createElement(kind);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  made.textContent = text;
  return made;
};

export class Controls {
  /** ask: sends a request to the daemon and resolves to its answer. */
  constructor(first, all, ask) {
    this.first = first;
    this.all = all;
    this.ask = ask;
    this.made = new Map();
  }

  show(settings) {
    const order = ({ key }) => (FIRST.includes(key) ? FIRST.indexOf(key) : FIRST.length);
    for (const key of [...settings.keys].sort((one, other) => order(one) - order(other))) {
      if (!this.made.has(key.key)) {
        const control = new Control(key, this.ask);
        this.made.set(key.key, control);
        if (FIRST.includes(key.key)) this.first.insertBefore(control.box, this.first.lastElementChild);
        else this.all.append(control.box);
      }
      this.made.get(key.key).show(key, settings.recording);
    }
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
    const name = key.key.split(".").pop().replace(UNITS, "").replaceAll("_", " ");
    this.output = element("output");
    label.append(element("label", { for: id, id: `${id}-label` }, name[0].toUpperCase() + name.slice(1)), this.output);
    this.error = element("p", { class: "error", role: "alert", id: `${id}-error` });
    const foot = element("div", { class: "foot" });
    this.reset = element("button", { type: "button", "aria-label": `${name}: default` }, "Default");
    this.reset.onclick = () => this.set(null);
    foot.append(element("p", { class: "meaning", title: key.change }, key.schema.enum || key.schema.type === "boolean" ? key.meaning : `${key.meaning}; ${key.allowed}`), this.reset);
    this.box.append(label, this.input(id), foot, this.error);
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
    const slider = element("input", { type: "range", id, min: schema.minimum, max: schema.maximum, step });
    const exact = element("input", { type: "number", step: "any", "aria-labelledby": `${id}-label`, "aria-describedby": `${id}-error` });
    slider.oninput = () => { exact.value = slider.value; this.set(Number(slider.value)); };
    exact.onchange = () => this.set(exact.value === "" ? null : Number(exact.value));
    row.append(slider, exact);
    this.field = slider;
    this.put = (value) => { // a word such as "auto" stands for a number that the daemon chooses
      const isNumber = typeof value === "number";
      if (document.activeElement !== exact) exact.value = isNumber ? value : "";
      slider.value = isNumber ? value : value === null ? schema.maximum : 0;
      slider.dataset.unset = !isNumber;
    };
    return row;
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
    const inputs = words.map((word, index) => {
      const label = element("label"), input = element("input", { type: "radio", name: id, value: word });
      if (!index) input.id = id;
      input.onchange = () => this.set(word);
      label.append(input, element("span", {}, String(word)));
      group.append(label);
      return input;
    });
    this.put = (value) => inputs.forEach((input) => { input.checked = input.value === String(value); });
    return group;
  }

  show(key, recording) {
    this.key = key;
    this.box.dataset.unsaved = key.unsaved;
    this.reset.disabled = JSON.stringify(key.value) === JSON.stringify(key.default);
    if (this.busy || this.wanted !== undefined) return; // a change of our own is under way
    this.put(key.value);
    this.tell(key.value);
    this.box.querySelectorAll("input, select").forEach((field) => { field.disabled = recording; });
  }

  tell(value) {
    const isNumber = typeof value === "number";
    const shown = isNumber ? Number(value.toPrecision(6)) : value === true ? "on" : value === false ? "off" : value;
    this.output.textContent = value === null ? "not set" : Array.isArray(value) ? "" : `${shown} ${isNumber ? this.unit : ""}`.trim();
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
