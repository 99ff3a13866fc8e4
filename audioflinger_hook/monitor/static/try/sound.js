// A file's whole sound, for rendering: read from a WAV file in parts, or decoded by the browser.

import { openWav } from "./wav.js";

export const RATES = [44100, 48000];
const MEMORY_MAX = 1e9, DECODED_HZ = 48000, CHANNELS = 2, CHANNELS_MAX = 8, METADATA_MS = 10_000;
const BYTES_PER_S = 8000, FAR_S = 1e9; // of strongly compressed sound; after the end of any file

const gigabytes = (bytes) => `${(bytes / 1e9).toFixed(1)} GB`;

function refuse(name, { frames, channels }) {
  if (frames <= 0) throw new Error(`${name} has no sound: it lasts 0 s. Choose another file.`);
  if (channels > CHANNELS_MAX) throw new Error(`${name} has ${channels} channels; at most ${CHANNELS_MAX}.`);
}

/** What the worker renders: {samplerate, file} or {samplerate, planes}, and a `note`. An Error says why not. */
export async function wholeSound(file) {
  const { name } = file, wav = await openWav(file), direct = RATES.includes(wav?.samplerate);
  const known = wav ? 0 : await duration(file), unknown = Number.isNaN(known);
  const about = wav ?? { samplerate: DECODED_HZ, channels: CHANNELS, frames: DECODED_HZ * (unknown ? file.size / BYTES_PER_S : known) };
  refuse(name, about);
  const seconds = about.frames / Math.max(1, about.samplerate), minutes = Math.round(seconds / 60);
  const bytes = direct ? 4 * about.frames : 4 * DECODED_HZ * seconds * (1 + about.channels) + file.size;
  if (bytes > MEMORY_MAX) {
    const lasts = unknown ? "has no length that this browser can read, and may need" : `lasts ${minutes} minutes and needs`;
    throw new Error(`${name} ${lasts} ${gigabytes(bytes)} of memory; at most ${gigabytes(MEMORY_MAX)}. Cut it, or use \`cushion render\`.`);
  }
  return direct ? { samplerate: wav.samplerate, file, note: "" } : decoded(file, wav);
}

async function decoded(file, wav) {
  const sound = await new OfflineAudioContext(1, 1, DECODED_HZ).decodeAudioData(await file.arrayBuffer()).catch(() => {
    throw new Error(`${file.name} is no sound that this browser can read. Try WAV, MP3, FLAC, Ogg or MP4.`);
  });
  refuse(file.name, { frames: sound.length, channels: sound.numberOfChannels });
  const planes = Array.from({ length: sound.numberOfChannels }, (_, channel) => sound.getChannelData(channel));
  const note = wav ? `Its ${wav.samplerate} Hz were converted to ${DECODED_HZ} Hz.` : `The browser decoded it to ${DECODED_HZ} Hz.`;
  return { samplerate: DECODED_HZ, planes, note };
}

/** Length in s, NaN where the browser cannot say. */
function duration(file) {
  const element = new Audio(), address = URL.createObjectURL(file);
  return new Promise((settle) => {
    const end = () => {
      URL.revokeObjectURL(address);
      settle(Number.isFinite(element.duration) ? element.duration : NaN);
    };
    element.onloadedmetadata = () => {
      if (Number.isFinite(element.duration)) end();
      else element.currentTime = FAR_S; // a live recording's length is known at its end
    };
    element.onseeked = element.onerror = end;
    setTimeout(end, METADATA_MS);
    element.preload = "metadata";
    element.src = address;
  });
}
