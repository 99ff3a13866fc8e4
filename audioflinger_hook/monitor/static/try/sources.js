// Where the sound comes from: a file or scene that this page plays, the microphone, a tab or the whole system.

const RAW = { echoCancellation: false, noiseSuppression: false, autoGainControl: false, channelCount: { ideal: 2 } };
const REFUSED = {
  microphone: {
    NotAllowedError: "The microphone was refused. Allow it beside the page's address, then try again.",
    NotFoundError: "No microphone or line input was found. Connect one, then try again.",
    NotReadableError: "Another program keeps the microphone to itself. Close it, then try again.",
  },
  screen: {
    NotAllowedError: "No tab was shared. Choose one, and switch on its sound.",
    NotReadableError: "The system refused to share that. Choose something else.",
  },
};
const SILENT = "What you shared has no sound. Share again, and switch on “Also share audio”.";

const isLinux = () => /linux|cros|chrom/i.test(navigator.userAgentData?.platform ?? navigator.platform ?? "");

/** What this browser can take besides files: {microphone, screen: words on the button or "", note}. */
export function abilities() {
  const devices = navigator.mediaDevices, supported = devices?.getSupportedConstraints?.() ?? {};
  const shares = Boolean(devices?.getDisplayMedia && supported.suppressLocalAudioPlayback); // only these browsers share sound
  const note = shares ? (isLinux() ? "On Linux, browsers share the sound of a tab, not of the whole system." : "")
    : "This browser shares no sound of tabs; Chrome and Edge on a computer do.";
  return { microphone: Boolean(devices?.getUserMedia), screen: shares ? (isLinux() ? "Sound of a tab" : "Sound of a tab or the system") : "", note };
}

/** A stream of sound, which the page does not play. ended: called when the person or the device ends it. */
export async function capture(kind, ended) {
  let stream;
  try {
    stream = kind === "microphone"
      ? await navigator.mediaDevices.getUserMedia({ audio: RAW })
      : await navigator.mediaDevices.getDisplayMedia({ video: true, audio: RAW, systemAudio: "include" });
  } catch (error) {
    throw new Error(REFUSED[kind][error.name] ?? `The browser refused: ${error.message}.`);
  }
  const [track] = stream.getAudioTracks();
  const stop = () => stream.getTracks().forEach((one) => one.stop());
  if (!track) { stop(); throw new Error(SILENT); }
  for (const one of stream.getTracks()) one.onended = ended;
  return { stream, label: track.label, stop };
}
