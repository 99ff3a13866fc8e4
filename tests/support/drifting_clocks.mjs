// Plays vibration on a simulated clock that differs by some ppm; prints the worst error in ms after the first 5 s.

import { load } from "./page_module.mjs";

Object.assign(globalThis, { sampleRate: 48000, currentTime: 0 });
globalThis.AudioWorkletProcessor = class { port = { postMessage: (message) => { globalThis.told = message.position; } }; };
globalThis.registerProcessor = (_, kind) => { globalThis.Player = kind; };
globalThis.AudioContext = globalThis.HTMLMediaElement = class {};
await load("player.js");
const { ClockLock } = await load("output.js");

const QUANTUM = 128, PERIOD = 256, SECONDS = 120, DELAY_S = 0.06, found = {};
for (const ppm of [-300, -20, 0, 100, 300]) {
  const player = new Player({ processorOptions: { samplerate: 48000, lead: 1920 } }), lock = new ClockLock(), from = {};
  player.port.onmessage({ data: { from } });
  let sent = 0, worst = 0, step = { ppm: 0 }, next = 0;
  for (let block = 0; block < (SECONDS * 48000) / QUANTUM; block++) {
    const now = (block * QUANTUM) / (48000 * (1 - 1e-6 * ppm)); // s of the sound's clock; the other clock is slow
    for (; sent + PERIOD <= now * 48000; sent += PERIOD) from.onmessage({ data: { frame: sent, samples: new Float32Array(PERIOD) } });
    player.process([], [[new Float32Array(QUANTUM)]]);
    if (now < next || !globalThis.told) continue;
    next = now + 0.1;
    const error = 1000 * (now - DELAY_S - player.position / 48000) + 2 * Math.sin(block); // and noise
    step = lock.step(error);
    player.port.onmessage({ data: { step: step.rate, jump: 48 * step.jump } });
    if (now > 5) worst = Math.max(worst, Math.abs(error));
  }
  found[ppm] = { worst_ms: worst, told_ppm: step.ppm, dry: player.dry };
}
console.log(JSON.stringify(found));
