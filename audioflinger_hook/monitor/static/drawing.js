// What the canvases share: size, colours, scales.

export const still = matchMedia("(prefers-reduced-motion: reduce)");

/** Fit a canvas to its place and return its context, scaled so that a unit is a CSS pixel. */
export function fit(canvas) {
  const ratio = Math.min(2, window.devicePixelRatio || 1);
  const width = canvas.clientWidth, height = canvas.clientHeight;
  const changed = canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio);
  if (changed) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  return { context, width, height, changed, ratio };
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
export function share(hz, low, high) {
  return Math.min(1, Math.max(0, Math.log(hz / low) / Math.log(high / low)));
}

/** How strong an amplitude is shown, 0 to 1: -54 dBFS and below is nothing. */
export function strength(amplitude) {
  return amplitude > 0 ? Math.min(1, Math.max(0, 1 + (20 * Math.log10(amplitude)) / 54)) : 0;
}

export function hertz(hz) {
  return hz >= 1000 ? `${(hz / 1000).toFixed(hz >= 10000 ? 1 : 2)} kHz` : `${Math.round(hz)} Hz`;
}
