// The core in WebAssembly: sound in, vibration out. Pages, workers, worklets and Node use it alike.
//
// core.wasm has no allocator: this module gives each object a place behind the data of the core.

export const BLOCK = 4096; // most frames of one call
const RECORD_NAME = 36, RECORD_HEAD = 48, DESIGN_HEAD = 24, CHECKSUM = 8;
const INFO = 0, SOUND = 1, CONTROLS = 2, READINGS = 4; // indices of `core_sizes` in core.h
const LEVELS = 24, CHANNELS_MAX = 8, PARTIALS = 288; // offsets in CoreReadings

/** A design for another number of channels. design: Uint8Array, not changed. An Error: it is damaged. */
export function withChannels(design, channels) {
  const made = design.slice(), view = new DataView(made.buffer), end = made.length - CHECKSUM;
  if (end < DESIGN_HEAD || view.getUint32(end, true) !== crc32(made.subarray(0, end))) throw new Error("the design is damaged");
  for (let at = DESIGN_HEAD; at < end;) {
    const rows = view.getUint32(at + RECORD_NAME + 4, true), columns = view.getUint32(at + RECORD_NAME + 8, true);
    if (word(made.subarray(at, at + RECORD_NAME)) === "inputs") view.setBigInt64(at + RECORD_HEAD, BigInt(channels), true);
    at += RECORD_HEAD + 8 * Math.max(1, rows) * columns;
  }
  view.setUint32(end, crc32(made.subarray(0, end)), true);
  return made;
}

const word = (bytes) => String.fromCharCode(...bytes.subarray(0, bytes.indexOf(0)));

function crc32(bytes) {
  const table = Int32Array.from({ length: 256 }, (_, entry) => {
    for (let bit = 0; bit < 8; bit++) entry = (entry >>> 1) ^ (entry & 1 ? 0xedb88320 : 0);
    return entry;
  });
  let crc = -1;
  for (const byte of bytes) crc = (crc >>> 8) ^ table[(crc ^ byte) & 255];
  return ~crc >>> 0;
}

export class Core {
  /** wasm: bytes of core.wasm. design: Uint8Array. channels: of the sound. An Error says why a design is refused. */
  constructor(wasm, design, channels) {
    const core = this.core = new WebAssembly.Instance(new WebAssembly.Module(wasm), {}).exports;
    this.next = core.__heap_base.value;
    const fitted = withChannels(design, channels), at = this.place(fitted.length);
    new Uint8Array(core.memory.buffer).set(fitted, at);
    const size = (which) => new DataView(core.memory.buffer).getUint32(core.core_sizes.value + 8 * which, true);
    const info = this.place(size(INFO));
    const misfit = core.core_check(at, fitted.length, info);
    if (misfit) throw new Error(`the design cannot be used: ${word(new Uint8Array(core.memory.buffer, misfit))}`);
    const about = new DataView(core.memory.buffer, info);
    const memory = about.getUint32(32, true); // `about` ends with the next growth of the memory
    Object.assign(this, { channels, samplerate: about.getUint32(0, true), latency: about.getUint32(16, true) });
    this.controls = this.place(size(CONTROLS));
    this.readings = this.place(size(READINGS));
    this.sound = this.place(4 * BLOCK * channels);
    this.out = this.place(4 * BLOCK);
    this.about = this.place(size(SOUND));
    this.handle = core.core_open(at, fitted.length, this.place(memory));
    const view = new DataView(core.memory.buffer);
    view.setFloat64(this.controls, 1, true); // the gain on the sound
    [this.sound, 4, 4 * BLOCK, 0].forEach((word, index) => view.setInt32(this.about + 4 * index, word, true));
    this.inputs = Array.from({ length: channels }, (_, channel) =>
      new Float32Array(core.memory.buffer, this.sound + 4 * BLOCK * channel, BLOCK));
    this.vibration = new Float32Array(core.memory.buffer, this.out, BLOCK);
    this.numbers = new Float64Array(core.memory.buffer, this.readings, size(READINGS) / 8);
    this.counts = new Uint32Array(core.memory.buffer, this.readings, size(READINGS) / 4);
  }

  /** The address of new memory, which holds zeros. */
  place(bytes) {
    const { memory } = this.core, at = (this.next + 15) & ~15, missing = at + bytes - memory.buffer.byteLength;
    this.next = at + bytes;
    if (missing > 0) memory.grow(Math.ceil(missing / 65536));
    return at;
  }

  /** The vibration of the first `frames` frames of `inputs`, at most BLOCK; valid until the next call. */
  process(frames, measures = false) {
    this.core.core_process(this.handle, this.controls, this.about, this.out, frames, measures ? this.readings : 0);
    return this.vibration.subarray(0, frames);
  }

  /** What `process` measured: [peak, mean square] of each channel, and rows [Hz of the sound, Hz of the vibration, amplitude]. */
  read() {
    const level = (first) => [this.numbers[first], this.numbers[first + 1]];
    const first = PARTIALS / 8 + 1, count = this.counts[PARTIALS / 4];
    return {
      sound: Array.from({ length: Math.min(this.channels, CHANNELS_MAX) }, (_, channel) => level(LEVELS / 8 + 2 * channel)),
      vibration: [level(LEVELS / 8 + 2 * CHANNELS_MAX)],
      partials: Array.from({ length: count }, (_, row) => [...this.numbers.subarray(first + 3 * row, first + 3 * row + 3)]),
    };
  }
}
