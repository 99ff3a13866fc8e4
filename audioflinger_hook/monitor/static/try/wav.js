// WAV files: their samples, read as `cushion render` reads them, and the header that it writes.

const PCM = 1, FLOAT = 3, EXTENSIBLE = 0xfffe, CHUNKS_MAX = 1000;

/** Samples of a file as float32, from their bytes, by format and bits. */
const READERS = {
  [`${PCM} 8`]: (bytes) => scaled(new Uint8Array(bytes), 2 ** -7, 128),
  [`${PCM} 16`]: (bytes) => scaled(new Int16Array(bytes), 2 ** -15),
  [`${PCM} 24`]: (bytes) => scaled(widened(new Uint8Array(bytes)), 2 ** -31),
  [`${PCM} 32`]: (bytes) => scaled(new Int32Array(bytes), 2 ** -31),
  [`${FLOAT} 32`]: (bytes) => new Float32Array(bytes),
  [`${FLOAT} 64`]: (bytes) => Float32Array.from(new Float64Array(bytes)),
};

function scaled(samples, factor, zero = 0) {
  const out = new Float32Array(samples.length);
  for (let at = 0; at < out.length; at++) out[at] = (samples[at] - zero) * factor;
  return out;
}

function widened(bytes) {
  const out = new Int32Array(bytes.length / 3);
  for (let at = 0; at < out.length; at++) out[at] = (bytes[3 * at] << 8) | (bytes[3 * at + 1] << 16) | (bytes[3 * at + 2] << 24);
  return out;
}

/** Open a WAV file: {samplerate, channels, frames, read(first, count)}, or null if the browser must decode the file. */
export async function openWav(file) {
  const bytes = async (from, count) => new DataView(await file.slice(from, from + count).arrayBuffer());
  const name = (view, at) => (view.byteLength < at + 4 ? "" : String.fromCharCode(...new Uint8Array(view.buffer, at, 4)));
  const head = await bytes(0, 12);
  if (name(head, 0) !== "RIFF" || name(head, 8) !== "WAVE") return null;
  let format = null;
  for (let at = 12, chunks = 0; chunks < CHUNKS_MAX; chunks++) {
    const chunk = await bytes(at, 8), kind = name(chunk, 0), there = file.size - at - 8;
    if (chunk.byteLength < 8) return null;
    const size = chunk.getUint32(4, true);
    if (kind === "fmt ") format = await bytes(at + 8, Math.min(size, 40));
    if (kind === "data") return format && format.byteLength >= 16 ? sound(file, format, at + 8, Math.min(size || there, there)) : null;
    at += 8 + size + (size % 2);
  }
  return null;
}

function sound(file, format, first, size) {
  const kind = format.getUint16(0, true), bits = format.getUint16(14, true), channels = format.getUint16(2, true);
  const plain = kind === EXTENSIBLE && format.byteLength >= 26 ? format.getUint16(24, true) : kind;
  const decode = READERS[`${plain} ${bits}`], bytes = (channels * bits) / 8;
  if (!decode || !channels) return null;
  return {
    channels, samplerate: format.getUint32(4, true), frames: Math.floor(size / bytes),
    /** Frames from `from` on, one Float32Array for each channel. */
    async read(from, count) {
      const samples = decode(await file.slice(first + from * bytes, first + (from + count) * bytes).arrayBuffer());
      return Array.from({ length: channels }, (_, channel) => {
        const plane = new Float32Array(count);
        for (let frame = 0; frame < count; frame++) plane[frame] = samples[frame * channels + channel];
        return plane;
      });
    },
  };
}

/** The header of a float32 WAV file of one channel. */
export function wavHead(samplerate, frames) {
  const text = (word) => [...word].map((letter) => letter.charCodeAt(0));
  const word = (number) => [number, number >> 8, number >> 16, number >>> 24].map((byte) => byte & 255);
  const half = (number) => [number & 255, number >> 8];
  const format = [...half(FLOAT), ...half(1), ...word(samplerate), ...word(4 * samplerate), ...half(4), ...half(32), ...half(0)];
  const chunks = [
    ...text("WAVEJUNK"), ...word(28), ...Array(28).fill(0), ...text("fmt "), ...word(format.length), ...format,
    ...text("fact"), ...word(4), ...word(frames), ...text("data"), ...word(4 * frames),
  ];
  return Uint8Array.from([...text("RIFF"), ...word(chunks.length + 4 * frames), ...chunks]);
}
