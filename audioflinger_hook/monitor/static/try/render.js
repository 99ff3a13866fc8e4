// A whole sound becomes vibration, as `cushion render` makes it: latency removed, the end faded.

import { BLOCK, Core } from "./core.js";

const FADE_S = 0.005, TOLD_FRAMES = 1 << 18;

/**
 * The vibration of a sound as Float32Array.
 * sound: {samplerate, channels, frames, read(first, count)}. told: called with the share that is done; may wait.
 */
export async function render(wasm, design, sound, told = () => {}) {
  const core = new Core(wasm, design, sound.channels), made = new Float32Array(sound.frames);
  for (let at = 0; at < sound.frames + core.latency; at += TOLD_FRAMES) {
    const here = Math.max(0, Math.min(TOLD_FRAMES, sound.frames - at)), end = Math.min(TOLD_FRAMES, sound.frames + core.latency - at);
    const planes = here ? await sound.read(at, here) : [];
    for (let first = 0; first < end; first += BLOCK) {
      const count = Math.min(BLOCK, end - first);
      core.inputs.forEach((input, channel) => {
        input.fill(0);
        if (first < here) input.set(planes[channel].subarray(first, first + count));
      });
      const vibration = core.process(count), place = at + first - core.latency;
      for (let frame = Math.max(0, -place); frame < count; frame++) made[place + frame] = Math.min(1, Math.max(-1, vibration[frame]));
    }
    await told(Math.min(1, (at + end) / (sound.frames + core.latency)));
  }
  const last = made.subarray(Math.max(0, made.length - Math.floor(FADE_S * sound.samplerate)));
  last.forEach((sample, frame) => { last[frame] = sample * (0.5 + 0.5 * Math.cos(Math.PI * ((frame + 0.5) / last.length))); });
  return made;
}
