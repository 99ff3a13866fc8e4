// A file's whole sound, for rendering: read from a WAV file in parts, or decoded by the browser.

import { openWav } from "./wav.js";

export const RATES = [44100, 48000];
const MEMORY_MAX = 1e9, DECODED_HZ = 48000, CHANNELS = 2, CHANNELS_MAX = 8, METADATA_MS = 10_000;

const gigabytes = (bytes) => `${(bytes / 1e9).toFixed(1)} GB`;

function refuseLong(name, seconds, bytes) {
  if (bytes <= MEMORY_MAX) return;
  const minutes = Math.round(seconds / 60);
  throw new Error(`${name} lasts ${minutes} minutes and needs ${gigabytes(bytes)} of memory; at most ${gigabytes(MEMORY_MAX)}. Cut it, or use \`cushion render\`.`);
}

/** What the worker renders: {samplerate, file} or {samplerate, planes}, and a `note`. An Error says why not. */
export async function wholeSound(file) {
  const { name } = file, wav = await openWav(file);
  if (!wav || !RATES.includes(wav.samplerate)) return decoded(name, file, wav);
  if (wav.frames <= 0) throw new Error(`${name} has no sound: it lasts 0 s. Choose another file.`);
  if (wav.channels > CHANNELS_MAX) throw new Error(`${name} has ${wav.channels} channels; at most ${CHANNELS_MAX}.`);
  refuseLong(name, wav.frames / wav.samplerate, 4 * wav.frames);
  return { samplerate: wav.samplerate, file, note: "" };
}

async function decoded(name, file, wav) {
  const seconds = wav ? wav.frames / Math.max(1, wav.samplerate) : await duration(file);
  if (wav && wav.frames <= 0) throw new Error(`${name} has no sound: it lasts 0 s. Choose another file.`);
  refuseLong(name, seconds || 0, 4 * DECODED_HZ * (seconds || 0) * (1 + (wav?.channels ?? CHANNELS)) + file.size);
  let sound;
  try {
    sound = await new OfflineAudioContext(1, 1, DECODED_HZ).decodeAudioData(await file.arrayBuffer());
  } catch {
    throw new Error(`${name} is no sound that this browser can read. Try WAV, MP3, FLAC, Ogg or MP4.`);
  }
  if (!sound.length) throw new Error(`${name} has no sound: it lasts 0 s. Choose another file.`);
  if (sound.numberOfChannels > CHANNELS_MAX) throw new Error(`${name} has ${sound.numberOfChannels} channels; at most ${CHANNELS_MAX}.`);
  const planes = Array.from({ length: sound.numberOfChannels }, (_, channel) => sound.getChannelData(channel));
  const note = wav ? `Its ${wav.samplerate} Hz were converted to ${DECODED_HZ} Hz.` : `The browser decoded it to ${DECODED_HZ} Hz.`;
  return { samplerate: DECODED_HZ, planes, note };
}

/** Length in s from a file's head, NaN where the browser cannot say. */
function duration(file) {
  const element = new Audio(), address = URL.createObjectURL(file);
  return new Promise((settle) => {
    const end = () => {
      URL.revokeObjectURL(address);
      settle(Number.isFinite(element.duration) ? element.duration : NaN);
    };
    element.onloadedmetadata = element.onerror = end;
    setTimeout(end, METADATA_MS);
    element.preload = "metadata";
    element.src = address;
  });
}
