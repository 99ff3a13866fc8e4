// Vibration over the last ten seconds: the newest on the right, strength as brightness.

import { colours, fit, share, still, strength } from "/drawing.js";

const SPAN_MS = 10_000, LOW = 20, HIGH = 220, TICKS = [20, 40, 60, 100, 150, 220];
const GUTTER = 44, STILL_MS = 1000;

export class Waterfall {
  constructor(canvas) {
    this.canvas = canvas;
    this.past = [];
    this.drawn = 0;
    this.theme = "";
  }

  /** partials: of one frame, [{felt, amplitude}]; now: time in ms. */
  add(partials, now) {
    this.past.push({ at: now, partials });
    while (this.past.length && now - this.past[0].at > SPAN_MS) this.past.shift();
  }

  draw(now) {
    if (still.matches && now - this.drawn < STILL_MS) return;
    this.drawn = now;
    const { context, width, height } = fit(this.canvas), c = colours();
    const bottom = height - 20, top = 6, place = width - GUTTER;
    const y = (hz) => bottom - share(hz, LOW, HIGH) * (bottom - top);
    context.clearRect(0, 0, width, height);
    this.axes(context, c, width, bottom, y, place);
    context.fillStyle = c.vibration;
    for (let index = 0; index < this.past.length; index++) {
      const { at, partials } = this.past[index];
      const x = GUTTER + place * (1 - (now - at) / SPAN_MS);
      const next = this.past[index + 1]?.at ?? now;
      const wide = Math.max(1, Math.min(12, (place * (next - at)) / SPAN_MS) + 0.6);
      for (const one of partials) {
        const strong = strength(one.amplitude);
        if (strong <= 0) continue;
        const tall = 2 + 9 * strong, middle = y(one.felt);
        context.globalAlpha = 0.3 * strong;
        context.fillRect(x, middle - tall, wide, 2 * tall);
        context.globalAlpha = strong;
        context.fillRect(x, middle - tall / 2, wide, tall);
      }
    }
    context.globalAlpha = 1;
  }

  axes(context, c, width, bottom, y, place) {
    context.font = "13px system-ui, sans-serif";
    context.textBaseline = "middle";
    context.textAlign = "right";
    context.strokeStyle = c.line;
    context.fillStyle = c.quiet;
    context.lineWidth = 1;
    for (const hz of TICKS) {
      context.beginPath();
      context.moveTo(GUTTER, y(hz));
      context.lineTo(width, y(hz));
      context.stroke();
      context.fillText(hz, GUTTER - 8, y(hz));
    }
    for (const seconds of [10, 8, 6, 4, 2, 0]) {
      context.textAlign = seconds === 0 ? "right" : seconds === 10 ? "left" : "center";
      context.fillText(seconds ? `${seconds} s ago` : "now", GUTTER + place * (1 - seconds / 10), bottom + 12);
    }
  }
}
