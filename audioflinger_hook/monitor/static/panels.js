// The panels that both pages draw with the screen: frequencies, levels, and the vibration of the last ten seconds.

import { still } from "./drawing.js";
import { find } from "./elements.js";
import { Mapping } from "./mapping.js";
import { Meters } from "./meters.js";
import { Waterfall } from "./waterfall.js";

const CHANNELS = { 1: ["mono"], 2: ["L", "R"], 4: ["FL", "FR", "RL", "RR"], 6: ["FL", "FR", "C", "LFE", "RL", "RR"], 8: ["FL", "FR", "C", "LFE", "RL", "RR", "SL", "SR"] };
const STILL_MS = 250, STALE_MS = 1500, STALE_EVERY_MS = 100, NOTHING = { sound: [], vibration: [], partials: [] };

window.cushion = { frames: 0, partials: [] }; // what tests measure

export class Panels {
  /** told: called about once a second with the number of frames drawn a second. */
  constructor(told = () => {}) {
    Object.assign(this, { told, frame: NOTHING, fresh: false, drawn: 0, drawnAt: 0, arrivedAt: 0, counted: performance.now() });
    this.mapping = new Mapping(find("mapping"), find("strongest"));
    this.waterfall = new Waterfall(find("waterfall"));
    this.soundMeters = new Meters(find("sound-meters"), "Sound", (index, count) => CHANNELS[count]?.[index] ?? `${index + 1}`);
    this.vibrationMeters = new Meters(find("vibration-meters"), "Vibration", (index, count) => (count > 1 ? `${index + 1}` : "all"));
    requestAnimationFrame((now) => this.draw(now));
  }

  /** Show levels in dBFS and partials as they are played, the strongest first. level: factor on the vibration. */
  show({ sound, vibration, partials: rows, level }) {
    const decibels = (power) => Math.max(-150, 10 * Math.log10(power));
    const levels = (readings, factor = 1) => readings.map(([peak, square]) =>
      (factor ? [decibels(peak * peak), decibels(square)] : [-150, -150]));
    const partials = rows.map(([audio, felt, amplitude]) => ({ audio, felt, amplitude: level * amplitude }));
    partials.sort((one, other) => other.amplitude - one.amplitude);
    this.frame = { sound: levels(sound), vibration: levels(vibration, level), partials };
    [this.fresh, this.arrivedAt, window.cushion.partials] = [true, performance.now(), partials];
    this.waterfall.add(partials, this.arrivedAt);
  }

  draw(now) {
    requestAnimationFrame((next) => this.draw(next));
    const stale = now - this.arrivedAt > STALE_MS, wait = still.matches ? STILL_MS : stale ? STALE_EVERY_MS : 0;
    if (now - this.drawnAt < wait || !(this.fresh || stale)) return;
    if (stale) this.waterfall.add([], now);
    [this.fresh, this.drawnAt] = [false, now];
    const shown = stale ? NOTHING : this.frame;
    this.mapping.draw(shown.partials, now);
    this.waterfall.draw(now);
    this.soundMeters.draw(shown.sound, now);
    this.vibrationMeters.draw(shown.vibration, now);
    this.drawn++;
    window.cushion.frames++;
    if (now - this.counted <= 1000) return;
    this.told((1000 * this.drawn) / (now - this.counted));
    [this.counted, this.drawn] = [now, 0];
  }
}
