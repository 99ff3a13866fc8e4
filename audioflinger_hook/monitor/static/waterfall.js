// Vibration over the last ten seconds: the newest on the right, strength as brightness.
//
// Each frame is painted once, on a strip that is used in a circle; the strip is then copied.

import { colours, fit, line, share, still, strength } from "./drawing.js";

const SPAN_MS = 10_000, RANGE = [20, 220], TICKS = [20, 40, 60, 100, 150, 220];
const PAUSE_MS = 400, GUTTER = 44, STILL_MS = 1000, TOP = 6, FOOT = 22, NARROW = 520;

export class Waterfall {
  constructor(canvas) {
    // painted: time up to which the strip holds the vibration
    Object.assign(this, { canvas, strip: document.createElement("canvas"), past: [], painted: 0, drawn: 0, look: "" });
  }

  /** partials: of one frame, [{felt, amplitude}]; now: time in ms. */
  add(partials, now) {
    this.past.push({ at: now, partials });
    while (now - this.past[0].at > SPAN_MS) this.past.shift();
  }

  draw(now) {
    if (still.matches && now - this.drawn < STILL_MS) return;
    this.drawn = now;
    const { context, width, height, ratio } = fit(this.canvas), c = colours(), { strip } = this, span = width - GUTTER;
    const y = (hz) => height - FOOT - share(hz, ...RANGE) * (height - FOOT - TOP);
    const look = `${c.theme} ${width} ${height} ${ratio}`;
    if (look !== this.look) {
      [this.look, this.painted] = [look, 0];
      [strip.width, strip.height] = [Math.max(1, Math.round(span * ratio)), Math.round(height * ratio)];
    }
    this.paint(now, c, y, ratio);
    context.clearRect(0, 0, width, height);
    this.axes(context, c, y, width, span, height);
    const turn = (this.place(now) + 1) % strip.width; // what is newest lies before it
    const left = (strip.width - turn) / ratio; // the oldest begins where the newest has ended
    context.drawImage(strip, turn, 0, strip.width - turn, strip.height, GUTTER, 0, left, height);
    if (turn > 0) context.drawImage(strip, 0, 0, turn, strip.height, GUTTER + left, 0, turn / ratio, height);
  }

  /** The place of a time, which is not negative, on the strip, in its pixels. */
  place(at) {
    return Math.floor(((at % SPAN_MS) / SPAN_MS) * this.strip.width);
  }

  /** Paint what is not yet on the strip. y: gives the height of a frequency. */
  paint(now, c, y, ratio) {
    const context = this.strip.getContext("2d"), from = Math.max(0, this.painted, now - SPAN_MS), { width } = this.strip;
    this.clear(context, from, now);
    context.fillStyle = c.vibration;
    this.past.forEach(({ at, partials }, index) => {
      const next = this.past[index + 1]?.at ?? now, end = Math.min(next, now); // a frame may be newer than this picture
      if (end <= from || next - at > PAUSE_MS || at >= end) return; // painted already, followed by a pause, or newer
      const x = this.place(Math.max(at, from)), wide = Math.max(1, (this.place(end) - x + width) % width);
      for (const { felt, amplitude } of partials) {
        const strong = strength(amplitude), tall = (2 + 8 * strong) * ratio, middle = y(felt) * ratio;
        for (const [alpha, reach] of strong > 0 ? [[0.28 * strong, tall], [strong ** 1.4, tall / 2]] : []) {
          context.globalAlpha = alpha;
          context.fillRect(x, middle - reach, wide, 2 * reach);
        }
      }
    });
    context.globalAlpha = 1;
    this.painted = now;
  }

  clear(context, from, to) {
    const first = this.place(from), { width, height } = this.strip;
    const count = to - from >= SPAN_MS ? width : (this.place(to) - first + width) % width, part = Math.min(count, width - first);
    context.clearRect(first, 0, part, height);
    if (count > part) context.clearRect(0, 0, count - part, height);
  }

  axes(context, c, y, width, span, height) {
    [context.strokeStyle, context.fillStyle, context.textAlign] = [c.line, c.quiet, "right"];
    for (const hz of TICKS) {
      line(context, [GUTTER, y(hz)], [width, y(hz)]);
      context.fillText(hz, GUTTER - 8, y(hz));
    }
    for (const seconds of width < NARROW ? [10, 5, 0] : [10, 8, 6, 4, 2, 0]) {
      context.textAlign = seconds === 0 ? "right" : seconds === 10 ? "left" : "center";
      context.fillText(seconds ? `${seconds} s ago` : "now", GUTTER + span * (1 - seconds / 10), height - FOOT + 13);
    }
  }
}
