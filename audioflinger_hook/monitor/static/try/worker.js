// Renders a sound beside the page, so that the page stays awake; ending this worker cancels it.

import { render } from "./render.js";
import { openWav, wavHead } from "./wav.js";

/** data: {wasm, design} and a WAV `file`, or a decoded sound as `planes` of `samplerate`. */
onmessage = async ({ data: { wasm, design, file, planes, samplerate } }) => {
  try {
    const sound = planes ? decoded(planes, samplerate) : await openWav(file), began = performance.now();
    const vibration = await render(wasm, design, sound, (share) => postMessage({ share }));
    const seconds = sound.frames / sound.samplerate, took = (performance.now() - began) / 1000;
    const wav = new Blob([wavHead(sound.samplerate, sound.frames), vibration], { type: "audio/wav" });
    postMessage({ wav, seconds, speed: seconds / took });
  } catch (error) {
    postMessage({ error: error.name === "NotReadableError" ? "the file has changed or is gone; choose it again" : error.message });
  }
};

const decoded = (planes, samplerate) => ({
  samplerate, channels: planes.length, frames: planes[0].length,
  read: (first, count) => planes.map((plane) => plane.subarray(first, first + count)),
});
