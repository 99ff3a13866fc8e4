// Level meters: RMS, peak and the highest peak of the last two seconds, in dBFS.

const LOW = -60, HOLD_MS = 2000, WORDS_MS = 500, FLOOR = -149;

export class Meters {
  constructor(place, what, names) {
    this.place = place;
    this.what = what;
    this.names = names;
    this.rows = [];
    this.told = 0;
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
      const text = peak <= FLOOR ? "silent" : `${peak.toFixed(1)}`;
      row.value.textContent = text;
      row.meter.setAttribute("aria-valuenow", Math.max(LOW, peak).toFixed(0));
      row.meter.setAttribute("aria-valuetext", peak <= FLOOR ? "silent" : `peak ${text} dBFS, RMS ${rms.toFixed(1)} dBFS`);
    });
  }

  make(count) {
    this.rows = Array.from({ length: count }, (_, index) => {
      const row = document.createElement("div");
      row.className = "meter";
      const [name, track, value] = ["span", "div", "span"].map((kind) => row.appendChild(document.createElement(kind)));
      [name.className, track.className, value.className] = ["name", "track", "value"];
      name.textContent = this.names(index, count);
      const [peak, rms, hold] = ["i", "i", "b"].map((kind) => track.appendChild(document.createElement(kind)));
      peak.className = "peak";
      track.setAttribute("role", "meter");
      track.setAttribute("aria-label", `${this.what} ${name.textContent}`);
      track.setAttribute("aria-valuemin", LOW);
      track.setAttribute("aria-valuemax", 0);
      return { row, meter: track, peak, rms, hold, value, held: -150, since: 0 };
    });
    this.place.replaceChildren(...this.rows.map((one) => one.row));
  }
}

function share(dbfs) {
  return Math.min(1, Math.max(0, 1 - dbfs / LOW));
}
