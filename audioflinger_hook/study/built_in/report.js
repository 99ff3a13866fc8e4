// Draws the report of a study from its document, that of `cushion study report --json`.

const report = JSON.parse(document.getElementById("document").textContent);
const main = document.getElementById("report");
const FEW = 8; // under so many people, a bootstrap is too optimistic
const WIDTH = Math.min(496, innerWidth - 40); // a phone has figures of its own width, so that their text stays readable
const TESTED = { // what the score of a participant is, whose mean a t test compares with 0
  preference: "The first condition against all others", rating: "The first condition against the others", synchrony: "PSS against 0",
  threshold: "The first condition against the others", equal: "Equal strength against 0 dB", identification: "Right answers against guessing",
};
const INTERVALS = ["The 95 % intervals come from a bootstrap over participants, with 2 000 draws and expanded percentiles (Hesterberg 2015). " +
  "The bootstrap's bias is subtracted from the estimate."];
const METHODS = { // what the estimates of each paradigm mean
  preference: ["Log odds are worths of a Bradley-Terry model, relative to the mean of all conditions: " +
    "a difference of 0.7 means that the better of two conditions is chosen in two of three comparisons."],
  rating: ["Ratings go from 0 to 100."],
  synchrony: ["PSS (point of subjective simultaneity) is the delay of the vibration that seems simultaneous. JND (just noticeable difference) " +
    "is the distance from it at which half of the answers are “not simultaneous”, or 75 % are right about the order. Delays beyond it are noticed."],
  threshold: ["The level is that of 75 % right answers, relative to the level of the design.", "JND is the standard deviation of the decision noise."],
  equal: ["The level is the gain that makes a condition as strong as the reference.", "JND is the standard deviation of the decision noise."],
  identification: ["Bits are the mutual information of sound and answer: 0 if people guess; with four sounds, 2 if all answers are right."],
};
const LEFT = 8, RIGHT = 14, ROW = 42, BOTTOM = 44, HEIGHT = 190;

function made(space, name, attributes, children) {
  const one = space ? document.createElementNS("http://www.w3.org/2000/svg", name) : document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) one.setAttribute(key, value);
  one.append(...children.flat(Infinity).filter((child) => child !== "" && child != null));
  return one;
}
const element = (name, attributes = {}, ...children) => made(false, name, attributes, children);
const shape = (name, attributes = {}, ...children) => made(true, name, attributes, children);

/** A number as people read it: one digit after the point for large units, a real minus, "?" if unknown. */
function number(value, unit = "") {
  if (value === null) return "?";
  const text = value.toFixed(["ms", "dB", "of 100"].includes(unit) ? 1 : 2);
  return text.replace(Number(text) ? "" : "-", "").replace("-", "−");
}
/** A count with its noun: "1 participant", "2 participants". */
const counted = (count, noun) => `${count} ${noun}${count === 1 ? "" : "s"}`;
const chance = (p) => (p < 0.001 ? "p\u00a0<\u00a00.001" : `p\u00a0=\u00a0${p.toFixed(3)}`);

/** Round values for an axis, about five of them between low and high. */
function ticks(low, high) {
  const rough = (high - low) / 5, power = 10 ** Math.floor(Math.log10(rough));
  const step = power * [1, 2, 5, 10].find((one) => one * power >= rough);
  const first = Math.ceil(low / step - 1e-9), last = Math.floor(high / step + 1e-9);
  return Array.from({ length: last - first + 1 }, (_, i) => Number(((first + i) * step).toPrecision(12)));
}

function table(head, rows, caption, kind = "number") {
  const cells = (row) => row.map((cell, i) => element(i ? "td" : "th", i ? { class: kind } : { scope: "row" }, cell));
  const heads = head.map((cell, i) => element("th", { scope: "col", class: i ? kind : "" }, cell));
  return element("div", { class: "wide", tabindex: "0", role: "region", "aria-label": caption },
    element("table", {}, element("thead", {}, element("tr", {}, heads)), element("tbody", {}, rows.map((row) => element("tr", {}, cells(row))))));
}

function figure(height, label, caption, ...shapes) {
  const told = `${report.simulated ? "SIMULATED: " : ""}${label}; the table has the numbers`;
  const drawing = shape("svg", { viewBox: `0 0 ${WIDTH} ${height}`, role: "img", "aria-label": told }, shapes);
  if (report.simulated) {
    const at = `translate(${WIDTH / 2} ${(height - BOTTOM) / 2 + 16}) rotate(-8)`;
    drawing.append(shape("text", { class: "stamp", transform: at }, "SIMULATED"));
  }
  return element("figure", {}, drawing, element("figcaption", {}, caption));
}

/** A horizontal axis below a drawing, from low to high, and the function from a value to its place. */
function axis(low, high, y, title) {
  const place = (value) => LEFT + ((value - low) / (high - low)) * (WIDTH - LEFT - RIGHT);
  const shapes = [shape("line", { class: "axis", x1: LEFT, x2: WIDTH - RIGHT, y1: y, y2: y })];
  for (const value of ticks(low, high)) {
    shapes.push(shape("line", { class: "axis", x1: place(value), x2: place(value), y1: y, y2: y + 5 }));
    shapes.push(shape("text", { class: "quiet", x: place(value), y: y + 19, "text-anchor": "middle" }, String(value).replace("-", "−")));
  }
  shapes.push(shape("text", { x: (LEFT + WIDTH - RIGHT) / 2, y: y + 38, "text-anchor": "middle" }, title));
  return [place, shapes];
}

/** Estimates with intervals, one below the other; each name stands above its line, so that long names fit a phone. */
function estimates(name, unit, rows) {
  const values = rows.flatMap(([, one]) => [one.value, one.low ?? one.value, one.high ?? one.value, ...one.people]);
  let low = Math.min(...values), high = Math.max(...values);
  const margin = 0.05 * (high - low || 1), bottom = rows.length * ROW + 8;
  [low, high] = [low - margin, high + margin];
  const [place, shapes] = axis(low, high, bottom, unit);
  if (low < 0 && high > 0) shapes.push(shape("line", { class: "zero", x1: place(0), x2: place(0), y1: 0, y2: bottom }));
  rows.forEach(([label, one], i) => {
    const y = i * ROW + 24;
    shapes.push(shape("line", { class: "axis", x1: LEFT, x2: WIDTH - RIGHT, y1: y, y2: y }));
    shapes.push(shape("text", { x: LEFT, y: y - 10 }, label));
    one.people.forEach((value, k) => shapes.push(shape("circle", { class: "person", cx: place(value), cy: y + 8 + 4 * (k % 2), r: 2.5 })));
    if (one.low !== null) shapes.push(shape("line", { class: "interval", x1: place(one.low), x2: place(one.high), y1: y, y2: y }));
    shapes.push(shape("circle", { class: "estimate", cx: place(one.value), cy: y, r: 5 }));
  });
  const people = rows[0][1].people.length ? " Small dots: participants." : "";
  return figure(bottom + BOTTOM, `estimates of ${name}`, `Dot: estimate.${rows[0][1].low === null ? "" : " Line: 95 % interval."}${people}`, shapes);
}

/** Shares of counted answers at each delay or level. */
function curves(name, unit, of) {
  const all = Object.values(of).flat().map(([x]) => x), top = 22;
  const [place, shapes] = axis(Math.min(...all), Math.max(...all), HEIGHT, unit === "ms" ? "delay of the vibration in ms" : "level in dB");
  const up = (share) => HEIGHT - share * (HEIGHT - top);
  for (const share of [0.5, 1]) {
    shapes.push(shape("line", { class: "zero", x1: LEFT, x2: WIDTH - RIGHT, y1: up(share), y2: up(share) }));
    shapes.push(shape("text", { class: "quiet", x: WIDTH - RIGHT, y: up(share) - 4, "text-anchor": "end" }, `${100 * share} %`));
  }
  Object.entries(of).forEach(([condition, points], c) => {
    const way = points.map(([x, share], i) => `${i ? "L" : "M"}${place(x).toFixed(1)} ${up(share).toFixed(1)}`).join("");
    if (unit === "ms") shapes.push(shape("path", { class: `c${c % 4}`, d: way }));
    points.forEach(([x, share]) => shapes.push(shape("circle", { class: `c${c % 4}`, cx: place(x), cy: up(share), r: 4 })));
    shapes.push(shape("circle", { class: `c${c % 4}`, cx: LEFT + 6, cy: 18 * c + 8, r: 5 }), shape("text", { x: LEFT + 16, y: 18 * c + 13 }, condition));
  });
  return figure(HEIGHT + BOTTOM, `answers of ${name}`, "Dots: share of the counted answer (simultaneous, sound first, right, or tested one stronger).", shapes);
}

/** The name of a sound, from its file. */
const titled = (sound) => sound.replace(/.*\//, "").replace(/\.\w+$/, "");

/** Shares of each answer to each sound, as a shaded table. */
function confusion(condition, sounds, shares) {
  const rows = sounds.map((sound, i) => element("tr", {}, element("th", { scope: "row" }, titled(sound)),
    shares[i].map((share) => element("td", { class: "cell", style: `background: rgba(var(--shade), ${(0.45 * share).toFixed(2)})` }, `${Math.round(100 * share)} %`))));
  const head = ["sound", ...sounds.map(titled)].map((one, i) => element("th", { scope: "col", class: i ? "number" : "" }, i ? `“${one}”` : one));
  const stamp = report.simulated ? element("strong", {}, " SIMULATED") : "";
  return element("figure", {}, element("h4", {}, `Answers with ${condition}`, stamp),
    element("div", { class: "wide", tabindex: "0", role: "region", "aria-label": `answers with ${condition}` },
      element("table", {}, element("thead", {}, element("tr", {}, head)), element("tbody", {}, rows))));
}

function question([name, one]) {
  const rows = Object.entries(one.estimates), units = one.unit.split("; ");
  const size = rows.length / units.length;
  const panels = units.map((unit, u) => estimates(name, unit, rows.slice(u * size, (u + 1) * size)));
  const drawn = [...panels, ...(one.curves ? [curves(name, one.unit, one.curves)] : []),
    ...Object.entries(one.confusion ?? {}).map(([condition, shares]) => confusion(condition, one.sounds, shares))];
  const cells = rows.map(([label, { value, low, high }], i) => {
    const unit = units[Math.floor(i / size)];
    return [label, number(value, unit), low === null ? "none" : `${number(low, unit)} to ${number(high, unit)}`];
  });
  return element("section", {},
    element("h3", {}, `${name} `, element("small", {}, `${one.paradigm}, ${counted(one.participants, "participant")}`)),
    one.participants < FEW ? element("p", { class: "note" }, one.participants === 1 ? "Intervals and p need two or more participants." : "With so few people, the intervals are too short.") : "",
    element("div", { class: "result" }, element("div", {}, drawn), element("div", {},
      table([one.unit, "estimate", "95 % interval"], cells, `estimates of ${name}`),
      one.p === null ? "" : element("p", {}, `${TESTED[one.paradigm]}: ${chance(one.p)}`))));
}

const { wanted, began } = report.participants, excluded = Object.entries(report.excluded);
const questions = Object.entries(report.questions);
const isPlanned = ([, one]) => report.registered !== null && !one.exploratory;
const some = (found) => (found.length ? found.map(question) : [element("p", {}, "There is none.")]);
const methods = new Set(["Estimates are means over participants, or functions of such means.", ...questions.flatMap(([, one]) => [
  ...(one.participants > 1 ? INTERVALS : []), ...METHODS[one.paradigm], ...(one.p === null ? [] : ["A t test over participants gives p."])])]);
main.append(
  report.simulated ? element("p", { class: "simulated" }, "SIMULATED: no person took part") : "",
  element("p", {}, `${began} of ${counted(wanted, "participant")} began, and ${began - excluded.length} ${began - excluded.length === 1 ? "is" : "are"} analysed. The design `,
    report.registered ? `was registered on ${report.registered.replace("T", " ").replace("+00:00", " UTC")}, before the first of them began.` : "was not registered before the first of them began."),
  excluded.length ? table(["excluded", "reason"], excluded, "excluded participants", "words") : "",
  element("h2", {}, "Preregistered"), ...some(questions.filter(isPlanned)),
  element("h2", {}, "Exploratory"), ...some(questions.filter((one) => !isPlanned(one))),
  element("h2", {}, "Methods"),
  element("p", {}, [...methods].join(" ")),
  element("h2", {}, "Data and versions"),
  table(["what", "version"], Object.entries(report.versions).map(([name, value]) => [name, element("code", {}, value)]), "data and versions", "words"),
);
