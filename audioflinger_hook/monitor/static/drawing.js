// What the canvases share: size, colours, scales.

export const still = matchMedia("(prefers-reduced-motion: reduce)");

/** Fit a canvas to its place and return its context, scaled so that a unit is a CSS pixel. */
export function fit(canvas) {
  const ratio = Math.min(2, window.devicePixelRatio || 1);
  const width = canvas.clientWidth, height = canvas.clientHeight;
  for (const [side, size] of [["width", Math.round(width * ratio)], ["height", Math.round(height * ratio)]]) {
    if (canvas[side] !== size) canvas[side] = size; // setting it clears the canvas
  }
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.font = "13px system-ui, sans-serif";
  context.textBaseline = "middle";
  context.lineWidth = 1;
  return { context, width, height, ratio };
}

export function line(context, ...[first, ...others]) {
  context.beginPath();
  context.moveTo(...first);
  for (const point of others) context.lineTo(...point);
  context.stroke();
}

/** The colours of the theme, read once for each theme. */
let known = {};
export function colours() {
  const theme = document.documentElement.dataset.theme;
  if (known.theme !== theme) {
    const style = getComputedStyle(document.documentElement);
    known = { theme };
    for (const name of ["text", "quiet", "line", "panel", "raised", "sound", "vibration"]) {
      known[name] = style.getPropertyValue(`--${name}`).trim();
    }
  }
  return known;
}

/** Share of a logarithmic range, 0 to 1. */
export const share = (hz, low, high) => Math.min(1, Math.max(0, Math.log(hz / low) / Math.log(high / low)));

/** How strong an amplitude is shown, 0 to 1: -54 dBFS and below is nothing. */
export const strength = (amplitude) => (amplitude > 0 ? Math.min(1, Math.max(0, 1 + (20 * Math.log10(amplitude)) / 54)) : 0);

export function hertz(hz) {
  return hz >= 1000 ? `${(hz / 1000).toFixed(hz >= 10000 ? 1 : 2)} kHz` : `${Math.round(hz)} Hz`;
}
