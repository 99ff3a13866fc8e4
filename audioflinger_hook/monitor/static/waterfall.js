// Vibration over the last ten seconds: the newest on the right, strength as brightness.
//
// Each frame is painted once, on a strip that is used in a circle; the strip is then copied.

import { colours, fit, share, still, strength } from "/drawing.js";

const SPAN_MS = 10_000, LOW = 20, HIGH = 220, TICKS = [20, 40, 60, 100, 150, 220];
const PAUSE_MS = 400, GUTTER = 44, STILL_MS = 1000, TOP = 6, FOOT = 22, NARROW = 520;

export class Waterfall {
  constructor(canvas) {
    this.canvas = canvas;
    this.strip = document.createElement("canvas");
    this.past = [];
    this.painted = 0; // time up to which the strip holds the vibration
    this.drawn = 0;
    this.look = "";
  }

  /** partials: of one frame, [{felt, amplitude}]; now: time in ms. */
  add(partials, now) {
    this.past.push({ at: now, partials });
    while (this.past.length && now - this.past[0].at > SPAN_MS) this.past.shift();
  }

  draw(now) {
    if (still.matches && now - this.drawn < STILL_MS) return;
    this.drawn = now;
    const { context, width, height, ratio } = fit(this.canvas), c = colours();
    const bottom = height - FOOT, place = width - GUTTER;
    const look = `${c.theme} ${width} ${height} ${ratio}`;
    if (look !== this.look) this.restart(look, Math.round(place * ratio), Math.round(height * ratio));
    this.paint(now, c, bottom, ratio);
    context.clearRect(0, 0, width, height);
    this.axes(context, c, width, bottom, place);
    const wide = this.strip.width, turn = (this.place(now) + 1) % wide; // what is newest lies before it
    const left = (wide - turn) / ratio; // the oldest begins where the newest has ended
    context.drawImage(this.strip, turn, 0, wide - turn, this.strip.height, GUTTER, 0, left, height);
    if (turn > 0) context.drawImage(this.strip, 0, 0, turn, this.strip.height, GUTTER + left, 0, turn / ratio, height);
  }

  restart(look, wide, tall) {
    this.look = look;
    this.painted = 0;
    this.strip.width = Math.max(1, wide);
    this.strip.height = tall;
  }

  /** The place of a time on the strip, in its pixels. */
  place(at) {
    return Math.floor((((at % SPAN_MS) + SPAN_MS) % SPAN_MS) / SPAN_MS * this.strip.width);
  }

  /** Paint what is not yet on the strip. */
  paint(now, c, bottom, ratio) {
    const context = this.strip.getContext("2d");
    const from = Math.max(this.painted, now - SPAN_MS);
    this.clear(context, from, now);
    context.fillStyle = c.vibration;
    this.past.forEach(({ at, partials }, index) => {
      const next = this.past[index + 1]?.at ?? now, end = Math.min(next, now); // a frame may be newer than this picture
      // Painted already, followed by a pause, or newer.
      if (end <= from || next - at > PAUSE_MS || at >= end) return;
      const x = this.place(Math.max(at, from)), wide = Math.max(1, (this.place(end) - x + this.strip.width) % this.strip.width);
      for (const one of partials) {
        const strong = strength(one.amplitude);
        if (strong <= 0) continue;
        const tall = (2 + 8 * strong) * ratio, middle = (bottom - share(one.felt, LOW, HIGH) * (bottom - TOP)) * ratio;
        context.globalAlpha = 0.28 * strong;
        context.fillRect(x, middle - tall, wide, 2 * tall);
        context.globalAlpha = strong ** 1.4;
        context.fillRect(x, middle - tall / 2, wide, tall);
      }
    });
    context.globalAlpha = 1;
    this.painted = now;
  }

  clear(context, from, to) {
    const first = this.place(from), wide = this.strip.width, tall = this.strip.height;
    const count = to - from >= SPAN_MS ? wide : (this.place(to) - first + wide) % wide;
    const part = Math.min(count, wide - first);
    context.clearRect(first, 0, part, tall);
    if (count > part) context.clearRect(0, 0, count - part, tall);
  }

  axes(context, c, width, bottom, place) {
    context.font = "13px system-ui, sans-serif";
    context.textBaseline = "middle";
    context.textAlign = "right";
    context.strokeStyle = c.line;
    context.fillStyle = c.quiet;
    context.lineWidth = 1;
    for (const hz of TICKS) {
      const y = bottom - share(hz, LOW, HIGH) * (bottom - TOP);
      context.beginPath();
      context.moveTo(GUTTER, y);
      context.lineTo(width, y);
      context.stroke();
      context.fillText(hz, GUTTER - 8, y);
    }
    for (const seconds of width < NARROW ? [10, 5, 0] : [10, 8, 6, 4, 2, 0]) {
      context.textAlign = seconds === 0 ? "right" : seconds === 10 ? "left" : "center";
      context.fillText(seconds ? `${seconds} s ago` : "now", GUTTER + place * (1 - seconds / 10), bottom + 13);
    }
  }
}
