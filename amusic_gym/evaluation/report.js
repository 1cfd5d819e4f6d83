"use strict";
const DATA = JSON.parse(document.getElementById("data").textContent);
const loaded = { 0: DATA.first };
const state = { drive: 0, frame: 0, scope: 0 };
const $ = (id) => document.getElementById(id);
const words = (policy, weight) => DATA.policies[policy]?.[0].concat(weight === null ? "" : `, λ ${weight}`) ?? policy;
const percent = (share) => `${+(100 * share).toPrecision(3)}%`;

function draw(parent, name, attributes, text) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const key in attributes) made.setAttribute(key, attributes[key]);
  if (text !== undefined) made.textContent = text;
  parent.append(made);
  return made;
}

function blank(svg, height) {
  const width = svg.clientWidth || 320;
  svg.replaceChildren();
  svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
  svg.setAttribute("height", height);
  return width;
}

// ---- the drive ----

function drive(number, data) { // called by the scripts beside the page, too
  loaded[number] = data;
  if (number === state.drive) showDrive();
}

function choose(number) {
  state.drive = number;
  if (loaded[number]) return showDrive();
  const script = document.createElement("script");
  script.src = DATA.drives[number][3];
  script.onerror = () => { $("told").textContent = `${script.src.split("/").slice(-2).join("/")} is not beside this page.`; };
  document.head.append(script);
}

const bankOf = () => DATA.banks[DATA.drives[state.drive][0]];

function showDrive() {
  const [bank, policy, weight] = DATA.drives[state.drive], here = bankOf();
  $("bank").value = bank;
  $("policy").replaceChildren(...DATA.drives.flatMap(([of, name, lambda], number) =>
    of === bank ? [new Option(words(name, lambda), number, false, number === state.drive)] : []));
  $("frame").max = here.frames - 1;
  const right = loaded[state.drive].right, wrong = right.filter((value) => value < 1).length;
  $("drive-title").textContent = `${words(policy, weight)} on ${here.name}`;
  $("wrong").textContent = `failures only (${wrong} of ${here.frames} frames)`;
  $("failures").disabled = !wrong;
  if (!wrong) $("failures").checked = false;
  strip();
  show(Math.min(state.frame, here.frames - 1), 1);
  drawFront();
}

let xOf = () => 0;

function strip() {
  const d = loaded[state.drive], here = bankOf(), n = here.frames, svg = $("strip");
  const tall = 84, lane = 13, count = here.techniques.length, left = 66, right = 6;
  const height = tall + (count + 1) * lane + 58;
  const width = blank(svg, height), step = (width - left - right) / n;
  xOf = (frame) => left + (frame + 0.5) * step;
  const spans = (on, y, h) => {
    let path = "";
    for (let f = 0, from; f < n; f++) {
      if (!on(f)) continue;
      for (from = f; f + 1 < n && on(f + 1);) f++;
      path += `M${(left + from * step).toFixed(1)} ${y}h${((f + 1 - from) * step).toFixed(1)}v${h}H${(left + from * step).toFixed(1)}z`;
    }
    return path;
  };
  const label = (text, y) => draw(svg, "text", { x: left - 6, y, "text-anchor": "end" }, text);
  const yOf = (place) => 4 + (tall - 10) * (1 - place / Math.max(1, here.places - 1));
  const ticks = (values, keep) => values.reduce((path, place, f) => place < 0 || !keep(f) ? path
    : `${path}M${(left + f * step).toFixed(1)} ${yOf(place).toFixed(1)}h${Math.max(step, 1.5).toFixed(1)}`, "");
  label("place", 14);
  draw(svg, "path", { d: ticks(d.true, () => true), class: "true" });
  draw(svg, "path", { d: ticks(d.at, (f) => d.right[f] > 0), class: "ok line" });
  draw(svg, "path", { d: ticks(d.at, (f) => d.right[f] < 1), class: "bad line" });
  here.techniques.forEach((name, t) => {
    const y = tall + t * lane, fill = DATA.colours[name];
    label(name.length > 9 ? `${name.slice(0, 8)}…` : name, y + 9);
    draw(svg, "path", { d: spans((f) => d.ran[f] >> t & 1, y, lane - 3), fill });
    draw(svg, "path", { d: spans((f) => d.late[f] >> t & 1, y + 3, lane - 9), fill, opacity: 0.55 });
  });
  let y = tall + count * lane;
  label("right?", y + 10);
  draw(svg, "path", { d: spans((f) => d.right[f] > 0, y + 2, 8), class: "ok" });
  draw(svg, "path", { d: spans((f) => d.right[f] === 0, y, 12), class: "bad" });
  draw(svg, "path", { d: spans((f) => d.right[f] < 0, y + 2, 8), class: "none" });
  y += lane + 4;
  label("p̂", y + 16);
  draw(svg, "path", { d: `M${left} ${y}H${width - right}M${left} ${y + 24}H${width - right}`, class: "grid" });
  let pen = "M";
  draw(svg, "path", { class: "p", d: d.p.reduce((path, p, f) => {
    const at = p === null ? "" : `${pen}${xOf(f).toFixed(1)} ${(y + 24 - p * 0.24).toFixed(1)}`;
    pen = p === null ? "M" : "L";
    return path + at;
  }, "") });
  y += 40;
  const every = [10, 20, 50, 100, 200, 500, 1000, 2000, 5000].find((size) => n / size < width / 70) ?? n;
  for (let f = 0; f < n; f += every) draw(svg, "text", { x: xOf(f), y, "text-anchor": "middle" }, f || "frame 0");
  draw(svg, "line", { id: "cursor", y1: 0, y2: y - 12 });
}

function picture(id, sheets, at, about) {
  const box = $(id), here = box.firstElementChild;
  box.hidden = !sheets;
  if (!sheets) return;
  const none = at < 0, on = at % sheets.per, across = on % sheets.columns;
  const sheet = Math.floor(at / sheets.per), down = Math.floor(on / sheets.columns);
  here.setAttribute("aria-label", about);
  here.style.aspectRatio = `${sheets.width} / ${sheets.height}`;
  here.style.backgroundImage = none ? "none" : `url("${sheets.urls[sheet]}")`;
  here.style.backgroundSize = `${100 * sheets.columns}% auto`;
  const last = sheet === sheets.urls.length - 1, rows = Math.ceil((last ? sheets.count - sheet * sheets.per : sheets.per) / sheets.columns);
  here.style.backgroundPosition = `${100 * across / (sheets.columns - 1)}% ${rows > 1 ? 100 * down / (rows - 1) : 0}%`;
}

// Failures only: the next failure the way the slider went, else the one before.
function allowed(frame, way) {
  const right = loaded[state.drive].right;
  if (!$("failures").checked) return frame;
  for (const step of [way, -way])
    for (let f = frame; f >= 0 && f < right.length; f += step) if (right[f] < 1) return f;
  return frame;
}

function show(wanted, way = Math.sign(wanted - state.frame) || 1) {
  const d = loaded[state.drive], here = bankOf(), f = state.frame = allowed(wanted, way);
  const names = (bits) => here.techniques.filter((_, t) => bits >> t & 1).join(" + ");
  const place = d.at[f], verdict = ["no true place", "wrong", "right"][d.right[f] + 1];
  const off = d.right[f] === 0 && place >= 0 ? ` by ${d.off[f]} place${d.off[f] === 1 ? "" : "s"}` : "";
  const unit = here.costs === "runs" ? "runs" : "ms"; // with runs after the fact it may be more than all
  const facts = [
    ["Frame", `${f}`],
    ["Matched", place < 0 ? "no place yet" : `place ${place}: ${verdict}${off}`],
    ["True", d.true[f] < 0 ? "none" : `place ${d.true[f]}`],
    ["Ran", names(d.ran[f]) || "nothing"],
    ["p̂", d.p[f] === null ? "none" : (d.p[f] / 100).toFixed(2)],
    ["Cost", `${d.cost[f]} ${unit} (all techniques once: ${here.all})`],
  ];
  $("told").replaceChildren(...facts.map(([name, value]) => {
    const cell = document.createElement("span"), strong = document.createElement("b");
    strong.textContent = name;
    cell.append(strong, ` ${value}`);
    return cell;
  }));
  $("told").className = ["told", "told bad", "told ok"][d.right[f] + 1];
  $("frame").value = f;
  $("frame").setAttribute("aria-valuetext", facts.map((fact) => fact.join(" ")).join(", "));
  $("cursor").setAttribute("x1", xOf(f));
  $("cursor").setAttribute("x2", xOf(f));
  picture("query", here.query, f, `Camera image of frame ${f}`);
  picture("matched", here.reference, place, place < 0 ? "No place yet" : `Matched place ${place}`);
  picture("truth", here.reference, d.true[f], d.true[f] < 0 ? "No true place" : `True place ${d.true[f]}`);
}

function pointed(event) {
  if (event.type === "pointermove" && event.pointerType !== "mouse" && !event.buttons) return;
  const box = $("strip").getBoundingClientRect(), first = xOf(0), n = bankOf().frames;
  const frame = Math.round((event.clientX - box.left - first) / (n > 1 ? xOf(1) - first : 1));
  show(Math.max(0, Math.min(n - 1, frame)));
}

// ---- AUC against compute ----

function driveOf([, , , policy, weight]) {
  const bank = DATA.drives.length ? DATA.drives[state.drive][0] : 0;
  return DATA.drives.findIndex((each) => each[0] === bank && each[1] === policy && each[2] === weight);
}

function drawFront() {
  const scope = DATA.scopes[state.scope], svg = $("front");
  if (!scope) return;
  const focused = [...svg.querySelectorAll("circle")].indexOf(document.activeElement);
  const height = 330, left = 42, bottom = 36, width = blank(svg, height);
  const least = Math.min(...scope.points.filter((p) => p[0] > 0).map((p) => p[0]));
  const points = scope.points.map((p) => ({ p, x: Math.max(p[0], least / 2), words: words(p[3], p[4]), colour: DATA.policies[p[3]][1], group: DATA.policies[p[3]][2] }));
  const low = Math.min(...points.map((o) => o.x)) / 1.2, high = Math.max(1, ...points.map((o) => o.x)) * 1.15;
  const aucs = points.map((o) => o.p[1]), top = Math.max(...aucs), base = Math.min(...aucs), pad = Math.max(0.04 * (top - base), 0.004);
  const x = (c) => left + (width - left - 10) * Math.log(c / low) / Math.log(high / low);
  const y = (auc) => 10 + (height - 10 - bottom) * (top + pad - auc) / (top - base + 2 * pad);
  for (let e = -6; e < 2; e++) for (const m of [1, 2, 5]) {
    const c = m * 10 ** e;
    if (c < low || c > high || (width < 420 && m === 2)) continue;
    draw(svg, "path", { class: "grid", d: `M${x(c)} 10V${height - bottom}` });
    draw(svg, "text", { x: x(c), y: height - bottom + 14, "text-anchor": "middle" }, percent(c));
  }
  const size = [0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2].find((s) => (top - base + 2 * pad) / s < 8) ?? 0.2;
  for (let auc = Math.ceil((base - pad) / size) * size; auc <= top + pad; auc += size) {
    draw(svg, "path", { class: "grid", d: `M${left} ${y(auc)}H${width - 10}` });
    draw(svg, "text", { x: left - 5, y: y(auc) + 4, "text-anchor": "end" }, +auc.toFixed(3));
  }
  draw(svg, "text", { x: width - 10, y: height - 4, "text-anchor": "end" }, `compute, of running everything (${scope.costs} costs)`);
  draw(svg, "text", { x: 4, y: 9 }, "AUC");
  const grey = (o) => o.colour === "#000000" ? "currentColor" : o.colour || "var(--none)";
  const fixed = points.filter((o) => o.group === "fixed subset").sort((a, b) => a.x - b.x || b.p[1] - a.p[1]);
  let best = -1, path = "";
  for (const o of fixed) if (o.p[1] > best) { best = o.p[1]; path += `${path ? "H" : "M"}${x(o.x)}${path ? "V" : " "}${y(best)}`; }
  draw(svg, "path", { class: "step", d: path ? `${path}H${x(1)}` : "" });
  for (const policy of new Set(points.filter((o) => o.p[4] !== null).map((o) => o.p[3]))) {
    const own = points.filter((o) => o.p[3] === policy).sort((a, b) => a.x - b.x);
    draw(svg, "path", { class: "sweep", stroke: grey(own[0]), d: `M${own.map((o) => `${x(o.x)} ${y(o.p[1])}`).join("L")}` });
  }
  points.sort((a, b) => (b.group === "fixed subset") - (a.group === "fixed subset") || a.x - b.x);
  const told = (o) => `${o.words}: AUC ${o.p[1].toFixed(3)}${o.p[2] ? ` (95 %: ${o.p[2].map((v) => v.toFixed(3)).join(" to ")})` : ""}, compute ${percent(o.p[0])}`;
  points.forEach((o, number) => {
    const go = driveOf(o.p), small = o.group === "fixed subset", current = go >= 0 && go === state.drive;
    if (o.p[2] && current) draw(svg, "path", { class: "interval", stroke: grey(o), d: `M${x(o.x)} ${y(Math.max(base - pad, o.p[2][0]))}V${y(Math.min(top + pad, o.p[2][1]))}` });
    const dot = draw(svg, "circle", { cx: x(o.x), cy: y(o.p[1]), r: current ? 8 : small ? 4 : 5.5, fill: DATA.policies[o.p[3]][3] ? "var(--paper)" : grey(o), stroke: grey(o), class: current ? "current" : small ? "small" : "", role: "button", tabindex: number ? -1 : 0, "aria-label": told(o), "aria-pressed": current });
    draw(dot, "title", {}, told(o));
    dot.addEventListener("focus", () => { $("front-told").textContent = told(o) + (go < 0 ? "" : "; Enter shows its drive"); });
    dot.addEventListener("pointerenter", () => { $("front-told").textContent = told(o); });
    const pick = () => { if (go >= 0) choose(go); else $("front-told").textContent = `${told(o)}; its drive is not kept`; };
    dot.addEventListener("click", pick);
    dot.addEventListener("keydown", (event) => {
      const dots = [...svg.querySelectorAll("circle")], way = { ArrowRight: 1, ArrowUp: 1, ArrowLeft: -1, ArrowDown: -1 }[event.key];
      if (way) dots[(number + way + dots.length) % dots.length].focus();
      if (event.key === "Enter" || event.key === " ") pick();
      if (way || event.key === " ") event.preventDefault();
    });
  });
  if (focused >= 0) svg.querySelectorAll("circle")[focused].focus();
  const legend = new Map(points.toReversed().map((o) => [o.group, o]));
  $("legend").replaceChildren(...[...legend].map(([name, o]) => {
    const item = document.createElement("li"), mark = document.createElement("i");
    mark.style.borderColor = mark.style.background = name === "fixed subset" ? "var(--none)" : grey(o);
    if (DATA.policies[o.p[3]][3]) mark.style.background = "none";

    item.append(mark, name);
    return item;
  }));
}

// ---- tables ----

for (const table of document.querySelectorAll("table")) {
  const heads = [...table.tHead.rows[0].cells], body = table.tBodies[0];
  heads.forEach((head, column) => {
    const button = document.createElement("button");
    button.append(...head.childNodes);
    head.append(button);
    button.addEventListener("click", () => {
      const falling = head.ariaSort !== "descending";
      heads.forEach((other) => { other.ariaSort = null; });
      head.ariaSort = falling ? "descending" : "ascending";
      const value = (row) => row.cells[column].textContent.trim();
      const order = (a, b) => {
        const [x, y] = [parseFloat(a), parseFloat(b)];
        if (isNaN(x) || isNaN(y)) return isNaN(x) && isNaN(y) ? (falling ? -1 : 1) * a.localeCompare(b) : isNaN(x) - isNaN(y);
        return falling ? y - x : x - y;
      };
      body.append(...[...body.rows].sort((a, b) => order(value(a), value(b))));
    });
  });
  const save = document.createElement("button");
  save.textContent = "Download CSV";
  save.className = "save";
  save.addEventListener("click", () => {
    const cell = ({ textContent: text }) => `"${(/^[=+@-]/.test(text = text.trim()) && isNaN(parseFloat(text)) ? `'${text}` : text).replaceAll('"', '""')}"`;
    const lines = [...table.rows].map((row) => [...row.cells].map(cell).join(","));
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([`${lines.join("\r\n")}\r\n`], { type: "text/csv" }));
    link.download = `${table.dataset.name}.csv`;
    link.click();
  });
  table.closest("section").append(save);
}

// ---- start ----

$("scope").replaceChildren(...DATA.scopes.map((scope, number) => new Option(scope.bank === "mean" ? "mean over all routes" : scope.bank, number)));
$("scope").addEventListener("change", (event) => { state.scope = +event.target.value; drawFront(); });
if (DATA.drives.length) {
  $("bank").replaceChildren(...DATA.banks.map((bank, number) => new Option(bank.name, number)));
  $("bank").addEventListener("change", (event) => {
    const [, policy, weight] = DATA.drives[state.drive], bank = +event.target.value;
    const same = DATA.drives.findIndex((each) => each[0] === bank && each[1] === policy && each[2] === weight);
    choose(same < 0 ? DATA.drives.findIndex((each) => each[0] === bank) : same);
  });
  $("policy").addEventListener("change", (event) => choose(+event.target.value));
  $("frame").addEventListener("input", (event) => show(+event.target.value));
  $("failures").addEventListener("change", () => { $("strip").classList.toggle("failures", $("failures").checked); show(state.frame, 1); });
  for (const kind of ["pointermove", "pointerdown"]) $("strip").addEventListener(kind, pointed);
  $("highlights").append(...DATA.highlights.map(([text, number]) => {
    const button = document.createElement("button");
    button.textContent = text;
    button.addEventListener("click", () => choose(number));
    return button;
  }));
  state.frame = Math.floor(bankOf().frames / 2);
  showDrive();
} else {
  $("drive").remove();
  drawFront();
}
let before = 0;
new ResizeObserver(() => {
  if (before !== (before = document.body.clientWidth) && before) {
    if (DATA.drives.length && loaded[state.drive]) { strip(); show(state.frame, 1); }
    drawFront();
  }
}).observe(document.body);
