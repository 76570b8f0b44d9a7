"use strict";
// Stands behind `models`, the recursions as JavaScript, and `picture.js`, in one function.
const told = JSON.parse(document.getElementById("try-data").textContent);
const n = told.n, panel = document.getElementById("try_it");
const element = name => document.getElementById(`try-${name}`);
const signals = told.signals.map(unpacked);
const [measured, driving] = signals;
const time = Float64Array.from({length: n}, (_, k) => told.t0 + k * told.Ts);
const positions = told.models.map(m => m.parameters.map(() => 0));
const runs = told.models.map(() => null);
const said = told.models.map(() => []);
const error = new Float64Array(n);
const shown = {model: 0, from: 0, to: n, run: measured, theta: [], pending: false, span: null};

function unpacked(one) {
  const bytes = atob(one.data), raw = new Uint8Array(bytes.length), made = new Float64Array(n);
  for (let i = 0; i < bytes.length; i++) raw[i] = bytes.charCodeAt(i);
  const view = new DataView(raw.buffer);
  for (let k = 0; k < n; k++) made[k] = one.offset + view.getFloat32(4 * k, true);
  return made;
}

// ---- the run -----------------------------------------------------------------------------------------------------

function valueAt(p, position) {
  const value = position ? p.value + position * p.half / told.steps : p.value;
  return Math.min(Math.max(value, p.low === null ? -Infinity : p.low), p.high === null ? Infinity : p.high);
}

function simulate(m, theta) {
  const one = told.models[m], inputs = one.inputs.map(i => i === null ? time : signals[i]);
  runs[m] = runs[m] || models[m].states.map(() => new Float64Array(n));
  return models[m].simulate(inputs, one.start, theta, runs[m]);
}

function rms(spans) {
  let sum = 0, count = 0;
  for (const [from, to] of spans) {
    for (let k = from; k < to; k++) sum += error[k] * error[k];
    count += to - from;
  }
  return Math.sqrt(sum / count);
}

function compute() {
  const m = shown.model, one = told.models[m];
  shown.theta = one.parameters.map((p, i) => valueAt(p, positions[m][i]));
  shown.run = simulate(m, shown.theta);
  error.fill(0, 0, one.skip);
  for (let k = one.skip; k < n; k++) error[k] = measured[k] - shown.run[k];
}

// ---- words -------------------------------------------------------------------------------------------------------

function number(value, digits = 3) {
  const size = Math.abs(value);
  if (!Number.isFinite(value)) return "–";
  if (!value) return "0";
  if (size < 1e-3 || size >= 1e5) return value.toExponential(digits - 1);
  return value.toFixed(Math.max(0, digits - 1 - Math.floor(Math.log10(Number(size.toPrecision(digits))))));
}

const united = value => `${number(value)} ${told.units[1]}`.trim();
const percentOf = share => `${number(100 * share, 2)} %`;
const percent = value => percentOf(value / told.spread);

function say() {
  const all = rms([[0, n]]), held = rms(told.held), m = shown.model;
  panel.dataset.rms = String(all);
  panel.dataset.held = String(held);
  panel.dataset.model = String(m);
  panel.dataset.theta = JSON.stringify(shown.theta);
  const first = Number.isNaN(all) ? shown.run.findIndex(Number.isNaN) : -1;
  element("rms").textContent = first < 0 ? united(all) : `Unstable from ${number(time[first])} s`;
  const part = told.held.length ? `; shaded part ${united(held)}, ${percent(held)}` : "";
  element("said").textContent = first < 0 ? `rms error, ${percent(all)} of the output's standard deviation${part}`
    : "on: there the run leaves the finite numbers";
  told.models[m].parameters.forEach((p, i) => {
    if (said[m][i] === shown.theta[i]) return;
    said[m][i] = shown.theta[i];
    const value = `${number(shown.theta[i], 4)} ${p.unit}`.trim();
    element(`${m}-${i}-said`).textContent = value;
    element(`${m}-${i}`).setAttribute("aria-valuetext", value);
  });
}

// ---- pictures ----------------------------------------------------------------------------------------------------

const COARSE = 10000;  // points of a loop while something moves
const LAP = 12000;  // the point runs through what is shown [ms]
const CREST = 1.25;  // periods, to the first crest of full height

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
  trace(values, role) {
    this.stroked(role, pen => {
      const {from, to} = shown, columns = Math.max(1, Math.round(this.right - this.left)), each = (to - from) / columns;
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

  // Against the input: points that fall on the pixel before are left out, while something moves others too.
  loop(values, role, most = Infinity) {
    this.stroked(role, pen => {
      let lastX = NaN, lastY = NaN;
      const step = Math.max(1, Math.floor((shown.to - shown.from) / most));
      for (let k = shown.from; k < shown.to; k += step) {
        const x = Math.round(2 * this.across(driving[k])) / 2, y = Math.round(2 * this.up(values[k])) / 2;
        if (x !== lastX || y !== lastY) pen.lineTo(x, y);
        lastX = x;
        lastY = y;
      }
    });
  }

  aside() { for (const one of told.aside) this.span(...one); }
}

const [uLabel, yLabel, errorLabel] = told.axes, colours = {};
const pictures = {
  time: new Run(element("time"), colours, "", yLabel), error: new Run(element("error"), colours, TIME, errorLabel),
  loop: new Run(element("loop"), colours, uLabel, yLabel),
};

function readColours() {
  Object.assign(colours, coloursOf(panel, ["ink", "rule"]));
}

function draw(fine) {
  const {from, to, run} = shown, {time: over, error: beside, loop} = pictures;
  const role = shown.model ? "after" : "before";
  const across = [time[from], time[to - 1]], span = shown.span, key = [colours.ink, from, to];
  over.background(key, across, span.y, () => { over.aside(); over.trace(measured, "measured"); });
  over.trace(run, role);
  beside.background(key, across, span.error, () => { beside.aside(); beside.band([-told.floor, told.floor], "floor"); });
  beside.trace(error, role);
  loop.background(key, span.u, span.y, () => loop.loop(measured, "measured"));
  loop.loop(run, role, fine ? Infinity : COARSE);
}

// ---- the point that runs along both loops --------------------------------------------------------------------------

const player = {input: element("point"), button: element("play"), on: false, began: 0, used: false};
const [now, dotMeasured, dotRun] = [".try-now", ".try-dot.measured", ".try-dot.run"].map(s => panel.querySelector(s));

function point() {
  if (!player.used) return;
  const {from, to, run} = shown, k = from + Math.round(player.input.value / player.input.max * (to - 1 - from));
  const {time: over, loop} = pictures;
  const put = (mark, x, y) => {
    mark.style.display = Number.isFinite(y) ? "block" : "none";
    mark.style.transform = `translate(${x.toFixed(1)}px, ${y.toFixed(1)}px)`;
  };
  put(now, over.across(time[k]), 0);
  put(dotMeasured, loop.across(driving[k]), loop.up(measured[k]));
  put(dotRun, loop.across(driving[k]), loop.up(run[k]));
  dotRun.style.background = LOOKS[shown.model ? "after" : "before"].colour;
  player.input.setAttribute("aria-valuetext", `${number(time[k], 4)} s`);
  panel.dataset.point = String(k);
}

function play(stamp) {
  if (!player.on) return;
  const share = (stamp - player.began) / LAP;
  player.input.value = Math.round(share % 1 * player.input.max);
  point();
  requestAnimationFrame(play);
}

player.button.addEventListener("click", () => {
  player.on = !player.on;
  player.used = true;
  player.button.textContent = player.on ? "Pause" : "Play";
  player.began = performance.now() - player.input.value / player.input.max * LAP;
  requestAnimationFrame(play);
});
player.input.addEventListener("input", () => {
  player.used = true;
  player.began = performance.now() - player.input.value / player.input.max * LAP;
  point();
});

// ---- the law ------------------------------------------------------------------------------------------------------

const asked = told.law && {amplitude: element("amplitude"), period: element("period"), r: new Float64Array(told.law.n + told.law.ahead),
  t: Float64Array.from({length: told.law.n}, (_, k) => k * told.Ts),
  picture: new Picture(element("reference"), colours, TIME, `r${told.axes[1].slice(1)}`),
  input: new Picture(element("input"), colours, TIME, told.axes[0])};

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
  element("amplitude-said").textContent = `${number(amplitude)} ${told.units[1]}`.trim();
  element("period-said").textContent = `${number(period * told.Ts)} s`;
  asked.amplitude.setAttribute("aria-valuetext", element("amplitude-said").textContent);
  asked.period.setAttribute("aria-valuetext", element("period-said").textContent);
  element("law-said").textContent = bad ? "The law has no finite input for this reference."
    : `The input goes from ${shownAt(low)} to ${shownAt(high)}; `
      + (beyond ? `${percentOf(beyond / (one.n - lead))} of it beyond what was measured.` : "all of it within what was measured.");
  panel.dataset.law = JSON.stringify({amplitude, period, theta, low, high, beyond});
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
  compute();
  say();
  draw(n <= COARSE);
  point();
  if (asked) follow();
  clearTimeout(shown.rest);
  if (n > COARSE) shown.rest = setTimeout(() => draw(true), 150);
}

function later() {  // at most once for each frame
  if (!shown.pending) {
    shown.pending = true;
    requestAnimationFrame(update);
  }
}

// The axes stay while a parameter moves: they show the base's error, in the stretch that is looked at.
function look(from, to) {
  const least = Math.min(n, 20), middle = (from + to) / 2;
  if (to - from < least) [from, to] = [Math.round(middle - least / 2), Math.round(middle + least / 2)];
  shown.from = Math.max(0, Math.min(from, n - least));
  shown.to = Math.min(n, Math.max(to, shown.from + least));
  const high = extent([worst], shown.from, shown.to).map(Math.abs), top = Math.max(...high, 2 * told.floor);
  shown.span = {y: extent([measured], shown.from, shown.to), u: extent([driving], shown.from, shown.to), error: [-top, top]};
  const whole = shown.from === 0 && shown.to === n;
  element("all").disabled = whole;
  element("earlier").disabled = shown.from === 0;
  element("later").disabled = shown.to === n;
  panel.dataset.from = String(shown.from);
  panel.dataset.to = String(shown.to);
  later();
}

// ---- what people do ------------------------------------------------------------------------------------------------

function select(m) {
  shown.model = m;
  for (const one of panel.querySelectorAll(".sliders")) one.hidden = Number(one.dataset.model) !== m;
  panel.querySelector(".of-before").hidden = m > 0;
  panel.querySelector(".of-after").hidden = !m;
  later();
}

function settled() { element("status").textContent = `${element("rms").textContent} ${element("said").textContent}`; }

panel.addEventListener("input", event => {
  const input = event.target;
  if (input.name === "try-model") return select(Number(input.value));
  if (input.dataset.parameter === undefined) return;
  positions[shown.model][Number(input.dataset.parameter)] = Number(input.value);
  later();
});
panel.addEventListener("change", () => requestAnimationFrame(settled));
element("reset").addEventListener("click", () => {
  positions[shown.model].fill(0);
  for (const input of panel.querySelectorAll(`.sliders[data-model="${shown.model}"] input`)) input.value = 0;
  later();
  requestAnimationFrame(settled);
});
const move = share => {
  const width = shown.to - shown.from, by = Math.round(share * width);
  const from = Math.min(Math.max(0, shown.from + by), n - width);
  look(from, from + width);
};
element("worst").addEventListener("click", () => look(...told.worst));
element("all").addEventListener("click", () => look(0, n));
element("earlier").addEventListener("click", () => move(-0.5));
element("later").addEventListener("click", () => move(0.5));

document.addEventListener("click", event => {  // a cell of the maps of errors
  const cell = event.target.closest("[data-stretch]");
  if (!cell) return;
  look(...cell.dataset.stretch.split(",").map(Number));
  panel.scrollIntoView();
});

for (const picture of [pictures.time, pictures.error]) {
  const canvas = picture.canvas, mark = document.createElement("span");
  let begun = 0;
  mark.className = "try-mark";
  canvas.parentElement.append(mark);
  const at = event => event.clientX - canvas.getBoundingClientRect().left;
  const sample = x => {
    const share = (x - picture.left) / (picture.right - picture.left);
    return Math.round(shown.from + Math.min(1, Math.max(0, share)) * (shown.to - shown.from));
  };
  const swept = event => [begun, at(event)].sort((p, q) => p - q);
  followed(canvas, {
    begin(event) { begun = at(event); },
    move(event) {
      const [a, b] = swept(event);
      Object.assign(mark.style, {display: "block", left: `${a}px`, width: `${b - a}px`});
    },
    end(event, lost) {
      const [a, b] = swept(event);
      mark.style.display = "none";
      if (!lost && b - a > 4) look(sample(a), sample(b));
    },
  });
  canvas.addEventListener("dblclick", () => look(0, n));
}

compute();  // the base at its optimum says how large an error is drawn
const worst = error.slice();
const checked = panel.querySelector('input[name="try-model"]:checked');
readColours();
select(checked ? Number(checked.value) : 0);
look(0, n);
for (const query of ["(prefers-color-scheme: dark)", "print"]) {
  window.matchMedia(query).addEventListener("change", () => { readColours(); later(); });
}
new ResizeObserver(later).observe(panel.querySelector(".try"));
