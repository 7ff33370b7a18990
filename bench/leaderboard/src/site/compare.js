// Compares two methods image by image, from data files that call strat().
"use strict";
const loaded = new Map();
const waiting = new Map();
function strat(kind, key, value) {
  loaded.set(`${kind} ${key}`, value);
}

// Data files are scripts, because a page from the file system may open nothing else.
function load(path, kind, key) {
  const name = `${kind} ${key}`;
  if (loaded.has(name)) return Promise.resolve(loaded.get(name));
  if (!waiting.has(name)) {
    waiting.set(name, new Promise((done, failed) => {
      const script = document.createElement("script");
      script.src = path;
      script.onload = () => (loaded.has(name) ? done(loaded.get(name)) : failed(new Error(`${path} holds something else`)));
      script.onerror = () => failed(new Error(`${path} is missing`));
      document.head.append(script);
    }));
  }
  return waiting.get(name);
}

const byId = (id) => document.getElementById(id);
const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));

function floats(text) {
  const view = new DataView(bytes(text).buffer);
  return Float64Array.from({ length: view.byteLength / 4 }, (_, index) => view.getFloat32(4 * index, true));
}

// --- Statistics: PROTOCOL 11, as bench has them. ---

function logGamma(x) {
  // Stirling's series, moved up to where it has all digits.
  let shift = 0;
  while (x < 15) { shift -= Math.log(x); x += 1; }
  const z = 1 / (x * x);
  const series = (1 / 12 - z * (1 / 360 - z * (1 / 1260 - z * (1 / 1680 - z * (1 / 1188 - z * 691 / 360360))))) / x;
  return shift + (x - 0.5) * Math.log(x) - x + 0.5 * Math.log(2 * Math.PI) + series;
}

function betaFraction(a, b, x) {
  const tiny = 1e-300;
  const away = (value) => (Math.abs(value) < tiny ? tiny : value);
  let numerator = 1;
  let denominator = 1 / away(1 - (a + b) * x / (a + 1));
  let fraction = denominator;
  for (let m = 1; m < 300; m += 1) {
    const even = m * (b - m) * x / ((a + 2 * m - 1) * (a + 2 * m));
    const odd = -(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1));
    let last = 0;
    for (const coefficient of [even, odd]) {
      denominator = 1 / away(1 + coefficient * denominator);
      numerator = away(1 + coefficient / numerator);
      last = numerator * denominator;
      fraction *= last;
    }
    if (Math.abs(last - 1) < 1e-15) break;
  }
  return fraction;
}

function tail(t, degrees) {
  const [a, b] = [0.5 * degrees, 0.5];
  const x = degrees / (degrees + t * t);
  if (x >= 1) return 1;
  const front = Math.exp(logGamma(a + b) - logGamma(a) - logGamma(b) + a * Math.log(x) + b * Math.log1p(-x));
  return x < (a + 1) / (a + b + 2) ? front * betaFraction(a, b, x) / a : 1 - front * betaFraction(b, a, 1 - x) / b;
}

function studentT(degrees) {
  let [low, high] = [0, 20];
  for (let step = 0; step < 60; step += 1) {
    const middle = 0.5 * (low + high);
    if (tail(middle, degrees) > 0.05) low = middle; else high = middle;
  }
  return 0.5 * (low + high);
}

const sum = (values) => values.reduce((total, value) => total + value, 0);

// 95 % interval of a difference: sums and numbers of images of each recording.
function interval(sums, sizes) {
  const total = sum(sizes);
  if (sizes.length < 3 || sizes.some((size) => size > 0.5 * total)) return null;
  const ratio = sum(sums) / total;
  const squares = sum(sums.map((one, index) => {
    const change = (one - ratio * sizes[index]) / (total - sizes[index]);
    return change * change;
  }));
  const error = Math.sqrt((sizes.length - 1) / sizes.length * squares);
  let [trace, square, outer, outerSquares] = [0, 0, 0, 0];
  for (const size of sizes) {
    const own = size / (1 - size / total);
    const others = own * own / total;
    trace += own;
    square += own * own;
    outer += others;
    outerSquares += others * others;
  }
  const half = studentT(trace * trace / (square + outer * outer - outerSquares)) * error;
  return [ratio - half, ratio + half];
}

// The stream of ChaCha with eight rounds under a key, from which `bench` draws patterns of signs: as
// many bytes as asked for, or a few more.
function stream(key, length) {
  const start = Uint32Array.of(0x61707865, 0x3320646e, 0x79622d32, 0x6b206574, ...new Uint32Array(12));
  const words = new DataView(key.buffer);
  for (let at = 0; at < 8; at += 1) start[4 + at] = words.getUint32(4 * at, true);
  const state = new Uint32Array(16);
  const turn = (at, bits) => { state[at] = state[at] << bits | state[at] >>> (32 - bits); };
  const quarter = (a, b, c, d) => {
    state[a] += state[b]; state[d] ^= state[a]; turn(d, 16);
    state[c] += state[d]; state[b] ^= state[c]; turn(b, 12);
    state[a] += state[b]; state[d] ^= state[a]; turn(d, 8);
    state[c] += state[d]; state[b] ^= state[c]; turn(b, 7);
  };
  const blocks = Math.ceil(length / 64);
  const out = new DataView(new ArrayBuffer(64 * blocks));
  for (let block = 0; block < blocks; block += 1) {
    start[12] = block;
    state.set(start);
    for (let round = 0; round < 8; round += 2) {
      for (let at = 0; at < 4; at += 1) quarter(at, at + 4, at + 8, at + 12);
      for (let at = 0; at < 4; at += 1) quarter(at, 4 + (at + 1) % 4, 8 + (at + 2) % 4, 12 + (at + 3) % 4);
    }
    for (let at = 0; at < 16; at += 1) out.setUint32(64 * block + 4 * at, state[at] + start[at], true);
  }
  return new Uint8Array(out.buffer);
}

// The patterns for so many recordings: a bit each, in whole words of 64.
function drawn(flips, count) {
  const stride = 8 * Math.ceil(count / 64);
  return { signs: stream(bytes(flips.key), flips.draws * stride), stride, draws: flips.draws };
}

// p of the sign-flip test: all patterns are counted, or those that were drawn.
function signFlip(sums, patterns) {
  const count = sums.length;
  if (count < 2) return null;
  const observed = Math.abs(sum(sums));
  const slack = 1e-12 * sum(sums.map(Math.abs));
  const tables = [];
  for (let first = 0; first < count; first += 8) {
    const part = sums.slice(first, first + 8);
    tables.push(Float64Array.from({ length: 256 }, (_, pattern) =>
      sum(part.map((value, bit) => (pattern >> bit & 1 ? -value : value)))));
  }
  let hits = 0;
  if (patterns === null) {
    for (let pattern = 0; pattern < 2 ** count; pattern += 1) {
      let total = tables[0][pattern & 255];
      if (tables.length > 1) total += tables[1][pattern >> 8];
      if (Math.abs(total) >= observed - slack) hits += 1;
    }
    return hits / 2 ** count;
  }
  const { signs, stride, draws } = patterns;
  for (let draw = 0; draw < draws; draw += 1) {
    let total = 0;
    for (let at = 0; at < tables.length; at += 1) total += tables[at][signs[stride * draw + at]];
    if (Math.abs(total) >= observed - slack) hits += 1;
  }
  return (hits + 1) / (draws + 1);
}

// --- What is shown. ---

const SVG = "http://www.w3.org/2000/svg";
function element(name, attributes, text) {
  const one = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) one.setAttribute(key, value);
  if (text !== undefined) one.textContent = text;
  return one;
}

function plot(width, height, label) {
  const svg = element("svg", { viewBox: `0 0 ${width} ${height}`, class: "plot", role: "img", "aria-label": label });
  svg.style.width = "100%";
  return svg;
}

function fill(table, header, lines) {
  const row = (cells, kind) => {
    const line = document.createElement("tr");
    cells.forEach((text, index) => {
      const cell = document.createElement(kind === "th" || index === 0 ? "th" : "td");
      if (kind === "th") cell.scope = "col"; else if (index === 0) cell.scope = "row";
      if (index > 0) cell.className = "n";
      cell.textContent = text;
      line.append(cell);
    });
    return line;
  };
  const [head, body] = [document.createElement("thead"), document.createElement("tbody")];
  head.append(row(header, "th"));
  body.append(...lines.map((cells) => row(cells, "td")));
  table.replaceChildren(head, body);
}

const signed = (value) => (value < 0 ? "" : "+") + value.toFixed(5);
const pText = (p) => (p === null ? "-" : p < 0.0001 ? "<0.0001" : p.toFixed(4));

function scatter(common, index, names) {
  const size = 420;
  const svg = plot(size, size, `Each image: ${names[0]} across, ${names[1]} up`);
  const values = common.flatMap((one) => [one.a[index], one.b[index]]);
  let [low, high] = [Math.min(...values), Math.max(...values)];
  if (!(low < high)) [low, high] = [low - 0.5, high + 0.5];
  const x = (value) => 50 + (size - 66) * (value - low) / (high - low);
  const y = (value) => size - 40 - (size - 56) * (value - low) / (high - low);
  svg.append(element("path", { class: "axis", d: `M${x(low)} ${y(low)}H${x(high)}M${x(low)} ${y(low)}V${y(high)}` }));
  svg.append(element("path", { class: "guide", d: `M${x(low)} ${y(low)}L${x(high)} ${y(high)}` }));
  for (const tick of [low, 0.5 * (low + high), high]) {
    svg.append(element("text", { x: x(tick), y: size - 24, "text-anchor": "middle" }, tick.toFixed(2)));
    svg.append(element("text", { x: 44, y: y(tick) + 4, "text-anchor": "end" }, tick.toFixed(2)));
  }
  svg.append(element("text", { x: x(0.5 * (low + high)), y: size - 8, "text-anchor": "middle" }, names[0]));
  const up = element("text", { x: 12, y: y(0.5 * (low + high)), "text-anchor": "middle" }, names[1]);
  up.setAttribute("transform", `rotate(-90 12 ${y(0.5 * (low + high))})`);
  svg.append(up);
  for (const one of common) {
    const dot = element("circle", { cx: x(one.a[index]).toFixed(1), cy: y(one.b[index]).toFixed(1), r: 3 });
    if (one.worse) dot.setAttribute("class", "worse");
    dot.append(element("title", {}, `${one.id}: ${one.a[index].toFixed(4)} and ${one.b[index].toFixed(4)}`));
    svg.append(dot);
  }
  byId("scatter").replaceChildren(svg);
}

// Bars of recordings; of very many those at both ends.
function drives(all, lower) {
  const line = 20;
  const left = all.length > 60 ? all.length - 60 : 0;
  const parts = left ? [...all.slice(0, 30), ...all.slice(-30)] : all;
  const svg = plot(560, line * parts.length + 30, "Mean difference per recording, second method less first");
  const largest = Math.max(...parts.map((one) => Math.abs(one.mean)), 1e-12);
  const x = (value) => 370 + 120 * value / largest;
  parts.forEach((one, index) => {
    const top = line * index + 6;
    const worse = lower ? one.mean > 0 : one.mean < 0;
    svg.append(element("text", { x: 236, y: top + 11, "text-anchor": "end" }, `${one.name} (${one.images})`));
    svg.append(element("rect", {
      x: Math.min(x(0), x(one.mean)), y: top, width: Math.abs(x(one.mean) - x(0)), height: line - 6,
      class: worse ? "worse" : "better",
    }));
    svg.append(element("text", { x: 552, y: top + 11, "text-anchor": "end" }, signed(one.mean)));
  });
  svg.append(element("path", { class: "axis", d: `M${x(0)} 0V${line * parts.length + 6}` }));
  if (left) {
    const words = `${left} recordings between the upper and the lower 30 are not drawn`;
    svg.append(element("text", { x: 552, y: line * parts.length + 20, "text-anchor": "end" }, words));
  }
  byId("drives").replaceChildren(svg);
}

let current = null;

async function show(index) {
  const section = index.sections.find((one) => one.id === byId("section").value);
  const ids = [byId("a").value, byId("b").value];
  const names = ids.map((id) => section.methods.find((one) => one[0] === id)[1]);
  const metric = Math.max(0, index.metrics.findIndex((one) => one[0] === byId("metric").value));
  const address = `#section=${section.id}&a=${ids[0]}&b=${ids[1]}&metric=${index.metrics[metric][0]}`;
  if (location.hash !== address) history.replaceState(null, "", address);
  byId("rendered").hidden = !section.rendered;
  const folder = `data/${section.id}`;
  const [images, ...both] = await Promise.all([
    load(`${folder}/images.js`, "images", section.id),
    ...ids.map((id) => load(`${folder}/${id}.js`, "values", `${section.id}/${id}`)),
  ]);
  const rows = both.map((one) => {
    const values = floats(one.values);
    const at = one.images || images.ids.keys();
    return new Map([...at].map((image, row) => [image, values.subarray(7 * row, 7 * row + 7)]));
  });
  const common = [...rows[0].keys()].filter((image) => rows[1].has(image)).map((image) => ({
    id: images.ids[image], recording: images.of[image], a: rows[0].get(image), b: rows[1].get(image),
  }));
  if (common.length === 0) throw new Error("The two methods have no image in common.");
  const recordings = [...new Set(common.map((one) => one.recording))].sort((a, b) => a - b);
  const patterns = recordings.length > index.flips.exact ? drawn(index.flips, recordings.length) : null;
  const sizes = recordings.map((one) => common.filter((image) => image.recording === one).length);
  const place = new Map(recordings.map((one, at) => [one, at]));
  const sums = (k) => {
    const totals = recordings.map(() => 0);
    for (const one of common) totals[place.get(one.recording)] += one.b[k] - one.a[k];
    return totals;
  };
  fill(byId("means"), ["Metric", names[0], names[1], "Difference", "95 % interval", "p"], index.metrics.map(([, heading], k) => {
    const totals = sums(k);
    const bounds = interval(totals, sizes);
    const mean = (side) => sum(common.map((one) => one[side][k])) / common.length;
    return [
      heading, mean("a").toFixed(4), mean("b").toFixed(4), signed(sum(totals) / common.length),
      bounds ? `${signed(bounds[0])} .. ${signed(bounds[1])}` : "-", pText(signFlip(totals, patterns)),
    ];
  }));
  const unpaired = rows[0].size + rows[1].size - 2 * common.length;
  byId("how").textContent = `${common.length} images of ${recordings.length} recordings`
    + (unpaired ? `, ${unpaired} more in one of them only` : "")
    + ". Difference: second method less first, with its 95 % t interval over recordings; p: sign flips of whole recordings, not corrected "
    + "for the number of tests (bench compare corrects after Holm).";
  const [, heading, lower] = index.metrics[metric];
  for (const one of common) one.worse = lower ? one.b[metric] > one.a[metric] : one.b[metric] < one.a[metric];
  scatter(common, metric, names);
  const totals = sums(metric);
  const parts = recordings.map((one, at) => ({ name: images.recordings[one], images: sizes[at], mean: totals[at] / sizes[at] }));
  parts.sort((a, b) => a.mean - b.mean);
  drives(parts, lower);
  const difference = (one) => one.b[metric] - one.a[metric];
  const sorted = [...common].sort((a, b) => difference(a) - difference(b));
  if (!lower) sorted.reverse();
  const cells = (one) => [one.id, one.a[metric].toFixed(4), one.b[metric].toFixed(4), signed(difference(one))];
  const header = ["Image", names[0], names[1], "Difference"];
  byId("better-a").textContent = `${heading}: better with ${names[0]}`;
  byId("better-b").textContent = `${heading}: better with ${names[1]}`;
  fill(byId("images-b"), header, sorted.filter((one) => !one.worse && difference(one) !== 0).slice(0, 10).map(cells));
  fill(byId("images-a"), header, sorted.filter((one) => one.worse).reverse().slice(0, 10).map(cells));
  current = { common, names, metrics: index.metrics, recordings: images.recordings };
  byId("result").hidden = false;
  byId("status").textContent = "";
}

function download() {
  const cell = (text) => {
    const safe = /^[=+@\t\r]/.test(text) || (/^-/.test(text) && Number.isNaN(Number(text))) ? `'${text}` : text;
    return /[",\n]/.test(safe) ? `"${safe.replaceAll('"', '""')}"` : safe;
  };
  const header = ["image", "recording", ...current.metrics.flatMap(([name]) => [`${name}_a`, `${name}_b`])];
  const lines = current.common.map((one) => [
    one.id, current.recordings[one.recording],
    ...current.metrics.flatMap((_, k) => [one.a[k].toPrecision(7), one.b[k].toPrecision(7)]),
  ]);
  const text = [header, ...lines].map((line) => line.map(cell).join(",")).join("\n");
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([`${text}\n`], { type: "text/csv" }));
  link.download = "comparison.csv";
  link.click();
}

function options(select, pairs, wanted) {
  select.replaceChildren(...pairs.map(([value, text]) => new Option(text, value)));
  if (pairs.some(([value]) => value === wanted)) select.value = wanted;
}

async function begin() {
  const index = await load("data/index.js", "index", "");
  const sections = index.sections.filter((one) => one.methods.length > 1);
  if (sections.length === 0) {
    byId("status").textContent = "No ranking has two methods yet.";
    return;
  }
  options(byId("metric"), index.metrics.map(([name, heading]) => [name, heading]));
  const choose = (asked) => {
    options(byId("section"), sections.map((one) => [one.id, one.title]), asked.get("section"));
    const section = sections.find((one) => one.id === byId("section").value);
    options(byId("a"), section.methods, asked.get("a"));
    options(byId("b"), section.methods, asked.get("b"));
    if (!asked.get("b")) byId("b").selectedIndex = byId("a").selectedIndex === 1 ? 0 : 1;
    byId("metric").value = index.metrics.some((one) => one[0] === asked.get("metric")) ? asked.get("metric") : section.first;
  };
  const told = () => show(index).catch((error) => {
    byId("result").hidden = true;
    byId("status").textContent = error.message;
  });
  const fromAddress = () => { choose(new URLSearchParams(location.hash.slice(1))); return told(); };
  byId("section").addEventListener("change", () => { choose(new URLSearchParams({ section: byId("section").value })); told(); });
  for (const id of ["a", "b", "metric"]) byId(id).addEventListener("change", told);
  byId("swap").addEventListener("click", () => {
    [byId("a").value, byId("b").value] = [byId("b").value, byId("a").value];
    told();
  });
  byId("download").addEventListener("click", download);
  window.addEventListener("hashchange", fromAddress);
  await fromAddress();
}

begin().catch((error) => { byId("status").textContent = error.message; });
