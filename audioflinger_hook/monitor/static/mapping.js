// The principal frequencies as they are mapped: sound on the left, vibration on the right, strength as width.

import { colours, fit, hertz, line, share, still, strength } from "./drawing.js";
import { element } from "./elements.js";

const TICKS = { audio: [20, 50, 100, 200, 500, 1000, 2000, 5000, 10000], felt: [20, 30, 50, 70, 100, 140, 220] };
const RANGES = { audio: [20, 12000], felt: [20, 220] };
const EDGE = 48, TOP = 14, TRAIL = 5; // frames that fade behind the newest
const LABELS = 6, LABEL_GAP = 21, WORDS_MS = 250;

export class Mapping {
  constructor(canvas, text) {
    Object.assign(this, { canvas, text, past: [], told: 0 });
  }

  /** partials: of one frame, [{audio, felt, amplitude}], the strongest first. */
  draw(partials, now) {
    this.past.unshift(partials);
    this.past.length = Math.min(this.past.length, still.matches ? 1 : TRAIL);
    const { context, width, height } = fit(this.canvas), c = colours();
    const y = (hz, kind) => height - TOP - share(hz, ...RANGES[kind]) * (height - 2 * TOP);
    const sides = [["audio", EDGE, -1, c.sound], ["felt", width - EDGE, 1, c.vibration]];
    context.clearRect(0, 0, width, height);
    for (const side of sides) this.axis(context, c, y, ...side);
    for (let age = this.past.length - 1; age >= 0; age--) {
      for (const one of [...this.past[age]].reverse()) this.ribbon(context, c, y, one, width, age);
    }
    for (const side of sides) this.labels(context, c, y, partials, ...side);
    if (now - this.told <= WORDS_MS) return;
    this.told = now;
    this.tell(partials);
  }

  axis(context, c, y, kind, x, side) {
    [context.strokeStyle, context.fillStyle, context.textAlign] = [c.line, c.quiet, side < 0 ? "right" : "left"];
    line(context, ...RANGES[kind].map((hz) => [x, y(hz, kind)]));
    for (const hz of TICKS[kind]) {
      line(context, [x, y(hz, kind)], [x + side * 5, y(hz, kind)]);
      context.fillText(hz >= 1000 ? `${hz / 1000}k` : hz, x + side * 10, y(hz, kind));
    }
  }

  ribbon(context, c, y, one, width, age) {
    const strong = strength(one.amplitude), left = EDGE, right = width - EDGE, middle = width / 2;
    if (strong <= 0) return;
    const from = y(one.audio, "audio"), to = y(one.felt, "felt"), gradient = context.createLinearGradient(left, 0, right, 0);
    gradient.addColorStop(0.1, c.sound);
    gradient.addColorStop(0.9, c.vibration);
    context.globalAlpha = (0.25 + 0.75 * strong) * (age ? 0.22 / age : 1);
    [context.strokeStyle, context.lineWidth, context.lineCap] = [gradient, 1 + 25 * strong * strong, "round"];
    context.beginPath();
    context.moveTo(left, from);
    context.bezierCurveTo(middle, from, middle, to, right, to);
    context.stroke();
    context.globalAlpha = 1;
  }

  labels(context, c, y, partials, kind, x, side, colour) {
    const taken = [];
    context.font = "700 15px system-ui, sans-serif";
    [context.lineJoin, context.lineWidth, context.strokeStyle, context.fillStyle] = ["round", 5, c.panel, colour];
    context.textAlign = side < 0 ? "left" : "right";
    for (const one of partials.slice(0, LABELS)) {
      const at = y(one[kind], kind);
      if (strength(one.amplitude) <= 0.1 || taken.some((other) => Math.abs(other - at) < LABEL_GAP)) continue;
      taken.push(at);
      context.strokeText(hertz(one[kind]), x - side * 18, at);
      context.fillText(hertz(one[kind]), x - side * 18, at);
    }
  }

  /** The strongest one in words, which a screen reader reads as well. */
  tell([one]) {
    const words = one ? [["of-sound", hertz(one.audio)], ["", " is felt as "], ["of-vibration", hertz(one.felt)]] : [["", "nothing"]];
    this.text.replaceChildren(...words.map(([kind, text]) => element("span", { class: kind }, text)));
  }
}
