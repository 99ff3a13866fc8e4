// Level meters: RMS, peak and the highest peak of the last two seconds, in dBFS.

import { element } from "./elements.js";

const LOW = -60, HOLD_MS = 2000, WORDS_MS = 500, FLOOR = -149;

const share = (dbfs) => Math.min(1, Math.max(0, 1 - dbfs / LOW));

export class Meters {
  /** names: gives the name of a meter from its index and the number of meters. */
  constructor(place, what, names) {
    Object.assign(this, { place, what, names, rows: [], told: 0 });
  }

  /** readings: [[peak, rms], ...] in dBFS; now: time in ms. */
  draw(readings, now) {
    if (readings.length && readings.length !== this.rows.length) this.make(readings.length);
    const tell = now - this.told > WORDS_MS;
    if (tell) this.told = now;
    this.rows.forEach((row, index) => {
      const [peak, rms] = readings[index] ?? [-150, -150];
      if (peak >= row.held || now - row.since > HOLD_MS) [row.held, row.since] = [peak, now];
      row.rms.style.transform = `scaleX(${share(rms)})`;
      row.peak.style.transform = `scaleX(${share(peak)})`;
      row.hold.style.transform = `translateX(calc(${100 * share(row.held)}% - 4px))`;
      if (!tell) return;
      const text = peak <= FLOOR ? "silent" : peak.toFixed(1);
      row.value.textContent = text;
      row.track.setAttribute("aria-valuenow", Math.max(LOW, peak).toFixed(0));
      row.track.setAttribute("aria-valuetext", peak <= FLOOR ? "silent" : `peak ${text} dBFS, RMS ${rms.toFixed(1)} dBFS`);
    });
  }

  make(count) {
    this.rows = Array.from({ length: count }, (_, index) => {
      const name = this.names(index, count), peak = element("i", { class: "peak" }), rms = element("i"), hold = element("b");
      const track = element("div", { class: "track", role: "meter", "aria-label": `${this.what} ${name}`,
        "aria-valuemin": LOW, "aria-valuemax": 0, "aria-valuenow": LOW }, peak, rms, hold);
      return { track, peak, rms, hold, name, value: element("span", { class: "value" }), held: -150, since: 0 };
    });
    this.place.replaceChildren(...this.rows.map(({ name, track, value }) =>
      element("div", { class: "meter" }, element("span", { class: "name" }, name), track, value)));
  }
}
