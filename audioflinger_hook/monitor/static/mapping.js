// The principal frequencies as they are mapped: sound on the left, vibration on the right, strength as width.

import { colours, fit, hertz, share, still, strength } from "/drawing.js";

const AUDIO = [20, 12000], FELT = [20, 220];
const AUDIO_TICKS = [20, 50, 100, 200, 500, 1000, 2000, 5000, 10000];
const FELT_TICKS = [20, 30, 50, 70, 100, 140, 220];
const TRAIL = 5; // frames that fade behind the newest
const LABELS = 6, LABEL_GAP = 21;

export class Mapping {
  constructor(canvas, text) {
    this.canvas = canvas;
    this.text = text;
    this.past = [];
    this.told = 0;
  }

  /** partials: of one frame, [{audio, felt, amplitude}], the strongest first. */
  draw(partials, now) {
    this.past.unshift(partials);
    this.past.length = Math.min(this.past.length, still.matches ? 1 : TRAIL);
    const { context, width, height } = fit(this.canvas);
    const c = colours(), left = 74, right = width - 74, top = 14, bottom = height - 14;
    const y = (hz, [low, high]) => bottom - share(hz, low, high) * (bottom - top);
    context.clearRect(0, 0, width, height);
    this.axes(context, c, left, right, y);
    for (let age = this.past.length - 1; age >= 0; age--) {
      for (const one of this.past[age].toReversed?.() ?? [...this.past[age]].reverse()) {
        this.ribbon(context, c, one, left, right, y, age);
      }
    }
    this.labels(context, c, partials, left, right, y);
    if (now - this.told > 250) {
      this.told = now;
      this.tell(partials);
    }
  }

  axes(context, c, left, right, y) {
    context.font = "13px system-ui, sans-serif";
    context.textBaseline = "middle";
    context.lineWidth = 1;
    for (const [x, ticks, range, side] of [[left, AUDIO_TICKS, AUDIO, -1], [right, FELT_TICKS, FELT, 1]]) {
      context.strokeStyle = c.line;
      context.beginPath();
      context.moveTo(x, y(range[0], range));
      context.lineTo(x, y(range[1], range));
      context.stroke();
      context.fillStyle = c.quiet;
      context.textAlign = side < 0 ? "right" : "left";
      for (const hz of ticks) {
        context.beginPath();
        context.moveTo(x, y(hz, range));
        context.lineTo(x + side * 5, y(hz, range));
        context.stroke();
        context.fillText(hz >= 1000 ? `${hz / 1000}k` : hz, x + side * 10, y(hz, range));
      }
    }
  }

  ribbon(context, c, one, left, right, y, age) {
    const strong = strength(one.amplitude);
    if (strong <= 0) return;
    const from = y(one.audio, AUDIO), to = y(one.felt, FELT), middle = (left + right) / 2;
    const gradient = context.createLinearGradient(left, 0, right, 0);
    gradient.addColorStop(0.1, c.sound);
    gradient.addColorStop(0.9, c.vibration);
    context.globalAlpha = (0.25 + 0.75 * strong) * (age ? 0.22 / age : 1);
    context.strokeStyle = gradient;
    context.lineWidth = 1 + 25 * strong * strong;
    context.lineCap = "round";
    context.beginPath();
    context.moveTo(left, from);
    context.bezierCurveTo(middle, from, middle, to, right, to);
    context.stroke();
    context.globalAlpha = 1;
  }

  labels(context, c, partials, left, right, y) {
    context.font = "700 15px system-ui, sans-serif";
    context.lineJoin = "round";
    context.strokeStyle = c.panel;
    context.lineWidth = 5;
    for (const [place, range, x, align, colour] of [
      ["audio", AUDIO, left + 18, "left", c.sound], ["felt", FELT, right - 18, "right", c.vibration]]) {
      const taken = [];
      context.textAlign = align;
      for (const one of partials.slice(0, LABELS)) {
        const at = y(one[place], range);
        if (strength(one.amplitude) <= 0.1 || taken.some((other) => Math.abs(other - at) < LABEL_GAP)) continue;
        taken.push(at);
        context.strokeText(hertz(one[place]), x, at);
        context.fillStyle = colour;
        context.fillText(hertz(one[place]), x, at);
      }
    }
  }

  /** The strongest one in words, which a screen reader reads as well. */
  tell(partials) {
    const [one] = partials;
    const spans = one ? [["of-sound", hertz(one.audio)], ["", " is felt as "], ["of-vibration", hertz(one.felt)]] : [["", "nothing"]];
    this.text.replaceChildren(...spans.map(([kind, text]) => {
      const span = document.createElement("span");
      span.className = kind;
      span.textContent = text;
      return span;
    }));
  }
}
