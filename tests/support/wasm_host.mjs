// usage: node wasm_host.mjs WASM DESIGN CHANNELS BLOCK <sound >vibration    interleaved float32 of both

import { readFileSync, writeFileSync } from "node:fs";
import { load } from "./page_module.mjs";

const { Core } = await load("core.js");

const [wasm, design, channels, block] = process.argv.slice(2);
const core = new Core(readFileSync(wasm), new Uint8Array(readFileSync(design)), Number(channels));
const bytes = readFileSync(0), sound = new Float32Array(bytes.buffer.slice(bytes.byteOffset), 0, bytes.length / 4);
const frames = sound.length / core.channels, vibration = new Float32Array(frames), took = [];
for (let at = 0; at < frames; at += Number(block)) {
  const count = Math.min(Number(block), frames - at), began = performance.now();
  core.inputs.forEach((input, channel) => {
    for (let frame = 0; frame < count; frame++) input[frame] = sound[(at + frame) * core.channels + channel];
  });
  vibration.set(core.process(count, true), at);
  took.push(performance.now() - began);
}
took.sort((one, other) => one - other);
console.error(JSON.stringify({ median_ms: took[took.length >> 1], p99_ms: took[Math.floor(took.length * 0.99)], ...core.read() }));
writeFileSync(1, new Uint8Array(vibration.buffer));
