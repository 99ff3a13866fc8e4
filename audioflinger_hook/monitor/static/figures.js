// Figures of the status: delay, health, rig and applications.

const PARTS = [["tap", "Tap"], ["transform", "Transform"], ["driving", "Damping and protection"], ["delay_line", "Delay line"],
  ["output", "Output"], ["delay", "Actuator"], ["offset", "Offset"]];
const PERCEIVED_MS = 24;

const element = (kind, text = "", attributes = {}) => {
  const made = document.createElement(kind);
  made.textContent = text;
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  return made;
};
const find = (id) => document.getElementById(id);

export function showDelay(latency) {
  const total = latency.total_ms, scale = Math.max(32, 1.08 * total, 1.08 * PERCEIVED_MS);
  const parts = PARTS.map(([key, name], index) => ({ name, ms: latency[`${key}_ms`], colour: `var(--part${index + 1})` }))
    .filter((part) => Math.abs(part.ms) >= 0.05);
  const felt = total <= PERCEIVED_MS ? "not perceived" : "may be perceived";
  find("delay").textContent = parts.length ? `${total.toFixed(1)} ms` : "–";
  const bars = parts.filter((part) => part.ms > 0).map((part) => {
    const bar = element("span");
    bar.style.width = `${(100 * part.ms) / scale}%`;
    bar.style.background = part.colour;
    return bar;
  });
  const limit = element("div", "", { class: "limit", "data-label": `${PERCEIVED_MS} ms: longer is perceived` });
  limit.style.left = `${(100 * PERCEIVED_MS) / scale}%`;
  find("budget").replaceChildren(...bars, limit);
  const words = parts.map((part) => `${part.name} ${part.ms.toFixed(1)} ms`).join(", ");
  find("budget").setAttribute("aria-label", parts.length ? `Delay ${total.toFixed(1)} ms, ${felt}: ${words}` : "No delay is known");
  find("parts").replaceChildren(...parts.map((part) => {
    const row = element("li"), mark = element("i");
    mark.style.background = part.colour;
    row.append(mark, element("span", part.name), element("span", `${part.ms.toFixed(1)} ms`));
    return row;
  }));
}

function rows(place, figures) {
  place.replaceChildren(...figures.map(([name, value, tone = ""]) => {
    const row = element("div");
    row.append(element("dt", name), element("dd", value, { "data-tone": tone }));
    return row;
  }));
}

export function showHealth(status) {
  const line = status.delay_line, native = status.engine === "native";
  const drops = status.xruns.tap + status.xruns.output + line.underflows;
  const causes = Object.entries(status.recoveries).filter(([, count]) => count);
  const load = native ? "inside PipeWire" : `${status.buffer_times.share_percent.toFixed(1)} % of a core`;
  rows(find("health"), [
    ["Dropouts", status.xruns.tap === null ? "not reported" : String(drops), drops ? "wait" : "good"],
    ["Recoveries", causes.map(([cause, count]) => `${cause} ${count}`).join(", ") || "none", causes.length ? "wait" : "good"],
    ["Load", load],
    ...(native ? [] : [["Clocks", `${line.ratio_ppm >= 0 ? "+" : ""}${line.ratio_ppm.toFixed(0)} ppm`]]),
    ["Limited samples", status.limited_samples.toLocaleString("en"), status.limited_samples ? "wait" : ""],
    ...status.warnings.slice(-3).map((warning) => ["Warning", warning, "wait"]),
    ...status.effects_bypassed.map((name) => ["Bypassed", name, "bad"]),
  ]);
}

export function showRig(status) {
  const { protection, exposure, actuators } = status, figures = [];
  if (protection) {
    figures.push(["Protection", `${(100 * protection.gain).toFixed(0)} % of the drive${protection.limited_by ? `, for ${protection.limited_by}` : ""}`,
      protection.gain < 1 ? "wait" : "good"]);
    if (protection.coil_c !== null) figures.push(["Coil, predicted", `${protection.coil_c.toFixed(0)} °C`]);
    figures.push(["Excursion, predicted", `${protection.excursion_mm.toFixed(2)} mm`]);
  }
  if (exposure) {
    const tone = exposure.above_limit ? "bad" : exposure.above_action ? "wait" : "good";
    const above = exposure.above_limit ? "above the limit, " : exposure.above_action ? "above the action value, " : "";
    figures.push(["Exposure A(8), predicted", `${above}${exposure.a8_m_s2.toPrecision(2)} m/s²`, tone]);
  }
  actuators.forEach((one, index) => figures.push([`Actuator ${index + 1}`,
    `${one.source} on ${one.channels.join(", ")}, ${one.rig}, ${one.gain_db.toFixed(1)} dB`]));
  find("rig").hidden = !figures.length;
  rows(find("rig-figures"), figures);
}

let shownApplications = "";
/** choose: called with the name of an application and whether it is to be felt. */
export function showApplications(applications, choose) {
  const state = JSON.stringify(applications);
  if (state === shownApplications) return; // else a key press on a button could be lost
  shownApplications = state;
  const focused = document.activeElement?.dataset?.application;
  find("applications").replaceChildren(...applications.map(({ name, plays, is_felt: felt }) => {
    const row = element("li"), title = element("span", name, { class: "name" });
    title.append(element("small", `${plays ? "plays" : "paused"}, ${felt ? "felt" : "left out"}`));
    const button = element("button", felt ? "Leave out" : "Include", { type: "button", "data-application": name,
      "aria-label": `${felt ? "Leave out" : "Include"} ${name}` });
    button.onclick = () => choose(name, !felt);
    row.append(title, button);
    return row;
  }));
  if (!applications.length) find("applications").append(element("li", "No application has a sound open.", { class: "none" }));
  document.querySelector(`[data-application="${CSS.escape(focused ?? "")}"]`)?.focus();
}
