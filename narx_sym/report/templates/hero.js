"use strict";
// The first screen and what moves with it; stands behind `models`, the recursions as JavaScript, and `picture.js`, in
// one function. What it shows is one JSON: narx_sym/report/hero.py says what is in it.
const told = JSON.parse(document.getElementById("hero-data").textContent);
const n = told.n, hero = document.getElementById("hero");
const element = name => document.getElementById(name);
const signals = told.signals.map(unpacked);
const [measured, driving] = signals;
const time = Float64Array.from({length: n}, (_, k) => told.t0 + k * told.Ts);
const positions = told.models.map(m => m.parameters.map(() => 0));
const runs = told.models.map(one => one.run && unpacked(one.run));
const rooms = models.map(one => one && one.states.map(() => new Float64Array(n)));
const said = told.models.map(() => []);
const error = new Float64Array(n);
const shown = {model: told.chosen, from: 0, to: n, theta: [], pending: false, span: null};
const moves = Boolean(element("try-time"));  // whether some model can be run here

function unpacked(one) {
  const bytes = atob(one.data), raw = new Uint8Array(bytes.length), made = new Float64Array(raw.length / 4);
  for (let i = 0; i < bytes.length; i++) raw[i] = bytes.charCodeAt(i);
  const view = new DataView(raw.buffer);
  for (let k = 0; k < made.length; k++) made[k] = one.offset + view.getFloat32(4 * k, true);
  return made;
}

// ---- the run -----------------------------------------------------------------------------------------------------

function valueAt(p, position) {
  const value = position ? p.value + position * p.half / told.steps : p.value;
  return Math.min(Math.max(value, p.low === null ? -Infinity : p.low), p.high === null ? Infinity : p.high);
}

function compute(m) {
  const one = told.models[m];
  shown.theta = one.parameters.map((p, i) => valueAt(p, positions[m][i]));
  if (models[m]) {
    const inputs = one.inputs.map(i => i === null ? time : signals[i]);
    runs[m] = models[m].simulate(inputs, one.start, shown.theta, rooms[m]);
  }
  error.fill(0, 0, one.skip);
  for (let k = one.skip; k < n; k++) error[k] = measured[k] - runs[m][k];
}

// ---- words -------------------------------------------------------------------------------------------------------

function number(value, digits = 3) {
  const size = Math.abs(value);
  if (!Number.isFinite(value)) return "–";
  if (!value) return "0";
  if (size < 1e-3 || size >= 1e5) return value.toExponential(digits - 1);
  return value.toFixed(Math.max(0, digits - 1 - Math.floor(Math.log10(Number(size.toPrecision(digits))))));
}

const united = (value, unit = told.units[1]) => `${number(value)} ${unit}`.trim();
const sized = value => united(told.prefix[0] * value, told.prefix[1]);  // of an error
const percentOf = share => `${number(100 * share, 2)} %`;

function rms(spans) {
  let sum = 0, count = 0;
  for (const [from, to] of spans) {
    for (let k = from; k < to; k++) sum += error[k] * error[k];
    count += to - from;
  }
  return Math.sqrt(sum / count);
}

function say() {
  const all = rms([[0, n]]), held = rms(told.held), m = shown.model;
  Object.assign(hero.dataset, {rms: all, held, model: m, theta: JSON.stringify(shown.theta)});
  if (!moves) return;
  const first = Number.isNaN(all) ? runs[m].findIndex(Number.isNaN) : -1;
  element("try-rms").textContent = first < 0 ? sized(all) : `Unstable from ${number(time[first])} s`;
  const part = told.held.length ? `; its shaded part ${sized(held)}` : "";
  element("try-said").textContent = first < 0 ? `rms error, ${percentOf(all / told.spread)} of the output's standard deviation${part}`
    : "on: the run diverges there";
  told.models[m].parameters.forEach((p, i) => {
    if (said[m][i] === shown.theta[i]) return;
    said[m][i] = shown.theta[i];
    const value = `${number(shown.theta[i], 4)} ${p.unit}`.trim();
    element(`try-${m}-${i}-said`).textContent = value;
    element(`try-${m}-${i}`).setAttribute("aria-valuetext", value);
  });
}

// ---- pictures ----------------------------------------------------------------------------------------------------

const COARSE = 10000;  // points of a loop while something moves
const LAP = 12000;  // the point runs through what is shown [ms]
const CREST = 1.25;  // periods, to the first crest of full height
const FALL = 500;  // the portrait becomes another one [ms]
const still = window.matchMedia("(prefers-reduced-motion: reduce)");

function extent(list, from, to) {
  let low = Infinity, high = -Infinity;
  for (const x of list) for (let k = from; k < to; k++) {
    if (x[k] < low) low = x[k];
    if (x[k] > high) high = x[k];
  }
  const room = 0.06 * (high - low) || 1;
  return [low - room, high + room];
}

// Over the record.
class Run extends Picture {
  // Over time: where there are several samples for a pixel, from their lowest to their highest value.
  trace(values, role, from = shown.from, to = shown.to) {
    this.stroked(role, pen => {
      const columns = Math.max(1, Math.round(this.right - this.left)), each = (to - from) / columns;
      if (each < 2) {
        for (let k = from; k < to; k++) pen.lineTo(this.across(time[k]), this.up(values[k]));
        return;
      }
      for (let i = 0; i < columns; i++) {
        const a = from + Math.floor(i * each), b = Math.min(to, from + Math.floor((i + 1) * each) + 1);
        let low = values[a], high = low;
        for (let k = a + 1; k < b; k++) {
          const value = values[k];
          if (value < low) low = value;
          else if (value > high) high = value;
        }
        const x = this.left + i + 0.5, rising = values[b - 1] >= values[a];
        pen.lineTo(x, this.up(rising ? low : high));
        pen.lineTo(x, this.up(rising ? high : low));
      }
    });
  }

  // One against the other: points that fall on the pixel before are left out, while something moves others too.
  loop(xs, ys, role, most = Infinity) {
    this.stroked(role, pen => {
      let lastX = NaN, lastY = NaN;
      const step = Math.max(1, Math.floor((shown.to - shown.from) / most));
      for (let k = shown.from; k < shown.to; k += step) {
        const x = Math.round(2 * this.across(xs[k])) / 2, y = Math.round(2 * this.up(ys[k])) / 2;
        if (x !== lastX || y !== lastY) pen.lineTo(x, y);
        lastX = x;
        lastY = y;
      }
    });
  }

  aside() { for (const one of told.aside) this.span(...one); }
}

const [uLabel, yLabel, errorLabel, rateLabel] = told.axes, colours = {};
const made = (kind, name, ...labels) => element(name) && new kind(element(name), colours, ...labels);
const pictures = {
  loop: told.rate ? made(Run, "hero-loop", rateLabel, uLabel) : made(Run, "hero-loop", uLabel, yLabel),
  strip: made(Run, "hero-strip", TIME, ""), portrait: made(Picture, "hero-portrait", ...(told.portrait?.axes ?? [])),
  time: made(Run, "try-time", "", yLabel), error: made(Run, "try-error", TIME, errorLabel),
};
const seen = one => one && one.canvas.clientWidth > 0;

function readColours() { Object.assign(colours, coloursOf(hero, ["ink", "rule"])); }

// What the loop shows of a run: output over input, or input over the rate of the output.
function sides(run) {
  if (!told.rate) return [driving, run];
  const w = told.rate, rate = new Float64Array(n);
  for (let k = 0; k < n; k++) {
    const low = Math.max(0, k - w), high = Math.min(n - 1, k + w);
    rate[k] = (run[high] - run[low]) / ((high - low) * told.Ts);
  }
  return [rate, driving];
}
const looped = sides(measured);

function draw(fine) {
  const {from, to, model, span} = shown, {time: over, error: beside, loop, strip} = pictures, run = runs[model];
  const role = model ? "after" : "before", most = fine ? Infinity : COARSE, key = [colours.ink, from, to];
  if (seen(loop)) {
    loop.background(key, span.x, span.y, () => loop.loop(...looped, "measured"));
    if (model) loop.loop(...sides(runs[0]), "before", most);
    loop.loop(...sides(run), role, most);
    strip.background([colours.ink], [time[0], time[n - 1]], extent([measured], 0, n),
      () => { strip.aside(); strip.trace(measured, "recorded", 0, n); });
    strip.area(strip.across(time[from]) - 1, strip.top, strip.across(time[to - 1]) + 1, strip.bottom, "brush");
  }
  if (!seen(over)) return;
  const across = [time[from], time[to - 1]];
  over.background(key, across, span.output, () => { over.aside(); over.trace(measured, "measured"); });
  over.trace(run, role);
  beside.background(key, across, span.error, () => { beside.aside(); beside.band([-told.floor, told.floor], "floor"); });
  beside.trace(error, role);
}

// What is missing, and what a switch leaves of it: it falls from one to the other.
const fallen = {before: told.chosen, now: told.chosen, began: -Infinity};

function portrait(stamp) {
  const picture = pictures.portrait, one = told.portrait, part = Math.min(1, (stamp - fallen.began) / FALL);
  if (!seen(picture)) return;
  const share = still.matches ? 1 : part * part * (3 - 2 * part), {before, now} = fallen;
  const mixed = list => list[now].map((v, i) => v === null ? NaN : share * v + (1 - share) * list[before][i]);
  const known = list => list.map(v => v === null ? NaN : v), [centres, half] = one.band;
  picture.begin(extent([one.x.filter(v => v !== null)], 0, one.x.filter(v => v !== null).length), [-one.high, one.high]);
  picture.filled([...centres, ...[...centres].reverse()], [...half, ...[...half].reverse().map(v => -v)], "range");
  picture.curve(picture.x, [0, 0], "zero");
  picture.dots(known(one.x), mixed(one.left), "sample");
  const law = now ? -1 : told.add;  // of what would be added
  if (element("hero-line")) element("hero-line").hidden = now > 0;
  if (law > 0) picture.curve(known(one.at), known(one.laws[law - 1]), "after");
  picture.dots(known(one.at), mixed(one.means), "mean");
  hero.dataset.left = String(mixed(one.means).reduce((most, v) => Math.max(most, Math.abs(v) || 0), 0));
  if (share < 1) requestAnimationFrame(portrait);
}

// ---- the point that runs along both loops --------------------------------------------------------------------------

const player = {input: element("try-point"), button: element("try-play"), on: false, began: 0, used: false};
const [now, dotMeasured, dotRun] = [".try-now", ".dot.measured", ".dot.run"].map(s => document.querySelector(s));

function point() {
  if (!player.used) return;
  const {from, to} = shown, run = runs[shown.model], {time: over, loop} = pictures;
  const k = from + Math.round(player.input.value / player.input.max * (to - 1 - from));
  const put = (mark, x, y) => {
    mark.style.display = Number.isFinite(y) ? "block" : "none";
    mark.style.transform = `translate(${x.toFixed(1)}px, ${y.toFixed(1)}px)`;
  };
  if (seen(over)) put(now, over.across(time[k]), 0);
  if (seen(loop)) {
    const of = ([xs, ys]) => [loop.across(xs[k]), loop.up(ys[k])];
    put(dotMeasured, ...of(looped));
    put(dotRun, ...of(sides(run)));
    dotRun.style.background = LOOKS[shown.model ? "after" : "before"].colour;
  }
  const text = `${number(time[k], 4)} s: ${united(driving[k], told.units[0])}, measured ${united(measured[k])}, run ${united(run[k])}`;
  element("try-point-said").textContent = text;
  player.input.setAttribute("aria-valuetext", text);
  hero.dataset.point = String(k);
}

function play(stamp) {
  if (!player.on) return;
  player.input.value = Math.round((stamp - player.began) / LAP % 1 * player.input.max);
  point();
  requestAnimationFrame(play);
}

function pointed(share) {
  player.used = true;
  if (share !== undefined) player.input.value = Math.round(share * player.input.max);
  player.began = performance.now() - player.input.value / player.input.max * LAP;
  point();
}

if (moves) {
  player.button.addEventListener("click", () => {
    player.on = !player.on;
    pointed();
    player.button.textContent = player.on ? "Pause" : "Play";
    requestAnimationFrame(play);
  });
  player.input.addEventListener("input", () => pointed());
  for (const one of [pictures.time, pictures.error]) one.canvas.addEventListener("pointermove", event => {
    const share = (one.at(event)[0] - one.x[0]) / (one.x[1] - one.x[0]);
    if (!player.on && !event.buttons && share >= 0 && share <= 1) pointed(share);
  });
}

// ---- the law ------------------------------------------------------------------------------------------------------

const asked = told.law && {amplitude: element("try-amplitude"), period: element("try-period"), r: new Float64Array(told.law.n + told.law.ahead),
  t: Float64Array.from({length: told.law.n}, (_, k) => k * told.Ts),
  picture: new Picture(element("try-reference"), colours, TIME, `r${told.axes[1].slice(1)}`),
  input: new Picture(element("try-input"), colours, TIME, told.axes[0])};

function follow() {
  const one = told.law, {r} = asked, amplitude = one.amplitude * asked.amplitude.value / 100;
  const period = one.period * asked.period.value / 100, {model, limits, lead} = one;
  for (let k = 0; k < r.length; k++) {  // it begins without a kink
    const turn = 2 * Math.PI * Math.max(0, k - lead) / period;
    r[k] = one.middle + amplitude * (turn < Math.PI ? (1 - Math.cos(turn)) / 2 : 1) * Math.sin(turn);
  }
  const theta = told.models[model].parameters.map((p, i) => valueAt(p, positions[model][i]));
  const input = law.simulate([r], one.start, theta);
  let low = Infinity, high = -Infinity, beyond = 0, bad = 0;
  for (let k = lead; k < one.n; k++) {
    low = Math.min(low, input[k]);
    high = Math.max(high, input[k]);
    if (Number.isNaN(input[k])) bad++;
    else if (input[k] < limits[0] || input[k] > limits[1]) beyond++;
  }
  const span = limits[1] - limits[0] || 1, across = [0, one.n * told.Ts], {picture, input: below, t} = asked;
  picture.begin(across, [one.middle - 2.2 * one.amplitude, one.middle + 2.2 * one.amplitude]);
  picture.curve(t, r.subarray(0, one.n), "reference");
  const x = picture.across((lead + CREST * period) * told.Ts), y = picture.up(one.middle + amplitude);
  picture.pen.fillStyle = LOOKS.reference.colour;
  picture.pen.beginPath();
  picture.pen.arc(x, y, 7, 0, 2 * Math.PI);
  picture.pen.fill();
  below.begin(across, [limits[0] - 0.4 * span, limits[1] + 0.4 * span]);
  for (const limit of limits) below.curve(across, [limit, limit], "limit");
  below.curve(t, input.subarray(0, one.n), "input");
  const unit = told.units[0], shownAt = value => `${number(value)} ${unit}`.trim();
  element("try-amplitude-said").textContent = `${number(amplitude)} ${told.units[1]}`.trim();
  element("try-period-said").textContent = `${number(period * told.Ts)} s`;
  asked.amplitude.setAttribute("aria-valuetext", element("try-amplitude-said").textContent);
  asked.period.setAttribute("aria-valuetext", element("try-period-said").textContent);
  element("try-law-said").textContent = bad ? "The law has no finite input for this reference."
    : `The input goes from ${shownAt(low)} to ${shownAt(high)}; `
      + (beyond ? `${percentOf(beyond / (one.n - lead))} of it is outside the measured range.` : "all of it is within the measured range.");
  hero.dataset.law = JSON.stringify({amplitude, period, theta, low, high, beyond});
}

function dragged(event) {
  const one = told.law, [t, level] = asked.picture.at(event);
  asked.amplitude.value = Math.round(100 * Math.abs(level - one.middle) / one.amplitude);
  asked.period.value = Math.round(100 * (t / told.Ts - one.lead) / CREST / one.period);
  later();
}

if (asked) {
  followed(asked.picture.canvas, {begin: dragged, move: dragged, end() {}});
  for (const slider of [asked.amplitude, asked.period]) slider.addEventListener("input", later);
}

function update() {
  shown.pending = false;
  compute(shown.model);
  say();
  draw(n <= COARSE);
  point();
  if (asked && seen(asked.picture)) follow();
  clearTimeout(shown.rest);
  if (n > COARSE) shown.rest = setTimeout(() => draw(true), 150);
}

function later() {  // at most once for each frame
  if (!shown.pending) {
    shown.pending = true;
    requestAnimationFrame(update);
  }
}

// What is measured, and as much of what the base makes of it as leaves the measured half of the axis.
function around(own, other, from, to) {
  const [low, high] = extent([own], from, to), [least, most] = extent([other], from, to), room = (high - low) / 2;
  return [Math.max(Math.min(low, least), low - room), Math.min(Math.max(high, most), high + room)];
}

// The axes stay while a parameter moves: they show the base's run and error, in the stretch that is looked at.
function look(from, to) {
  const least = Math.min(n, 20), middle = (from + to) / 2;
  if (to - from < least) [from, to] = [Math.round(middle - least / 2), Math.round(middle + least / 2)];
  from = shown.from = Math.max(0, Math.min(from, n - least));
  to = shown.to = Math.min(n, Math.max(to, from + least));
  const top = Math.max(...extent([worst], from, to).map(Math.abs), 2 * told.floor), [xs, ys] = looped;
  shown.span = {x: around(xs, base[0], from, to), y: around(ys, base[1], from, to),
    output: around(measured, first, from, to), error: [-top, top]};
  if (moves) for (const [name, off] of [["all", from === 0 && to === n], ["earlier", from === 0], ["later", to === n]]) {
    element(`try-${name}`).disabled = off;
  }
  Object.assign(hero.dataset, {from, to});
  later();
}

// ---- what people do ------------------------------------------------------------------------------------------------

const add = element("hero-add");
const added = () => shown.model > told.chosen ? shown.model : told.add;  // what the button adds

function select(m) {
  Object.assign(fallen, {before: fallen.now, now: m, began: performance.now()});
  shown.model = m;
  for (const one of document.querySelectorAll(".sliders")) one.hidden = Number(one.dataset.model) !== m;
  if (add) add.textContent = `${parent === window ? "Show with" : "Add"}${told.models[added()].name.slice(told.chosen ? told.models[told.chosen].name.length : 0).replace(/^ *\+/, "")}`;
  for (const one of hero.querySelectorAll('input[name="switch"]')) one.checked = Number(one.value) === m;
  requestAnimationFrame(portrait);
  later();
}

add?.addEventListener("click", () => {
  const m = added();
  select(m);
  hero.dataset.added = told.models[m].effect;
});
const settled = () => moves && requestAnimationFrame(() => {
  element("try-status").textContent = `${element("try-rms").textContent} ${element("try-said").textContent}`;
});
document.addEventListener("change", settled);
document.addEventListener("input", event => {
  const input = event.target;
  if (input.name === "switch") return select(Number(input.value));
  if (input.dataset.parameter === undefined) return;
  const m = Number(input.closest(".sliders").dataset.model);
  positions[m][Number(input.dataset.parameter)] = Number(input.value);
  later();
});
const step = share => {
  const width = shown.to - shown.from, from = Math.min(Math.max(0, shown.from + Math.round(share * width)), n - width);
  look(from, from + width);
};
for (const [name, press] of Object.entries({
  reset() {
    for (const one of positions) one.fill(0);
    for (const input of document.querySelectorAll("[data-parameter]")) input.value = 0;
    for (const one of asked ? [asked.amplitude, asked.period] : []) one.value = 100;
    later();
    settled();
  },
  worst() { look(...told.worst); }, all() { look(0, n); }, earlier() { step(-0.5); }, later() { step(0.5); },
})) element(`try-${name}`)?.addEventListener("click", press);

document.addEventListener("click", event => {  // a cell of the maps of errors
  const cell = event.target.closest("[data-stretch]");
  if (!cell) return;
  look(...cell.dataset.stretch.split(",").map(Number));
  hero.scrollIntoView();
});

for (const picture of [pictures.strip, pictures.time, pictures.error].filter(Boolean)) {
  const canvas = picture.canvas, mark = document.createElement("span");
  let begun = 0;
  mark.className = "swept";
  canvas.parentElement.append(mark);
  const at = event => event.clientX - canvas.getBoundingClientRect().left;
  const sample = x => Math.round(Math.min(n, Math.max(0, (picture.along(x) - told.t0) / told.Ts)));
  const swept = event => [begun, at(event)].sort((p, q) => p - q);
  followed(canvas, {
    begin(event) { begun = at(event); },
    move(event) {
      const [a, b] = swept(event);
      Object.assign(mark.style, {display: "block", left: `${a}px`, width: `${b - a}px`});
    },
    end(event, lost) {
      const [a, b] = swept(event), half = Math.round((shown.to - shown.from) / 2), k = sample(a);
      mark.style.display = "none";
      if (lost) return;
      if (b - a > 4) look(sample(a), sample(b));
      else if (picture === pictures.strip) step((Math.min(n - half, Math.max(half, k)) - half - shown.from) / (2 * half));
    },
  });
  canvas.addEventListener("dblclick", () => look(0, n));
}

compute(0);  // the base at its optimum says how large an error is drawn
const worst = error.slice(), first = runs[0].slice(), base = sides(first);
readColours();
const checked = hero.querySelector('input[name="switch"]:checked');
select(checked ? Number(checked.value) : told.chosen);
fallen.before = fallen.now;
look(...told.stretch);
update();  // a frame out of sight has no next frame of its own
const again = () => { readColours(); later(); requestAnimationFrame(portrait); };
for (const query of ["(prefers-color-scheme: dark)", "print"]) window.matchMedia(query).addEventListener("change", again);
new ResizeObserver(again).observe(hero);
for (const one of document.querySelectorAll("details:has(canvas)")) one.addEventListener("toggle", again);

// While effects are searched, the page around tells by how much the best of them lessen the base's error.
addEventListener("message", ({source, data}) => {
  if (source !== parent || !data.removed) return;
  document.querySelectorAll(".switch.found").forEach(one => one.remove());
  const first = hero.querySelector(".switch"), whole = parseFloat(first.querySelector(".bar.held").style.width);
  for (const [name, share] of data.removed) {
    const row = first.cloneNode(true), left = Math.sqrt(1 - share);
    row.classList.add("found");
    row.querySelector("input").remove();
    row.querySelector(".named").textContent = `+ ${name}`;
    row.querySelector(".error-of").remove();
    row.querySelector(".error-of small").textContent = "so far";
    Object.assign(row.querySelector(".bar"), {className: "bar after", style: `width: ${left * whole}%`});
    row.querySelector(".error-of > :last-child").textContent = `${percentOf(left)} of the base's`;
    hero.querySelector(".switches").append(row);
  }
});

// In a frame the page around it hears what is chosen, what is added, and how high this is.
if (parent !== window) {
  const tell = () => parent.postMessage({
    chosen: shown.model, theta: shown.theta, rms: Number.isFinite(Number(hero.dataset.rms)) ? Number(hero.dataset.rms) : null,
    added: hero.dataset.added ?? "", height: Math.ceil(document.body.getBoundingClientRect().bottom) + 8,
  }, "*");
  new MutationObserver(tell).observe(hero, {attributes: true, attributeFilter: ["data-rms", "data-theta", "data-model", "data-added"]});
  new ResizeObserver(tell).observe(document.body);
}
