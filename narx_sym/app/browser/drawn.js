// A reference that is drawn: the picture shows the points of the text beside it, and writes them there.
// Stands behind `picture.js`, in one module.
const MOST = 200;  // points; more the server refuses
const NEAR = 1.5;  // pixels that a point may lie beside the line that was drawn, to be left out
const STEPS = 100;  // of a key, over the height or the length of the picture
const MARGINS = 0.015;  // of the duration, on both sides: the first and the last point are seen whole
const ROOM = 0.25;  // of the identified range, above and below it
const past = {texts: [], at: -1, by: "", of: ""};  // what can be taken back, while the page is open
let last = null;  // the drawing that is shown

function pointsOf(text) {
  const lines = text.split(/[\n;]/).map(line => line.trim()).filter(line => line);
  const found = lines.map(line => line.split(/\s+/).map(part => Number(part.replace(",", "."))));
  const good = found.every((p, i) => p.length === 2 && p.every(Number.isFinite) && p[0] >= 0 && (!i || p[0] > found[i - 1][0]));
  return good && found.length && found.length <= MOST ? found : null;
}

// Points of a line that are enough to draw it (Ramer 1972; Douglas and Peucker 1973).
function enough(line, near) {
  const [x0, y0] = line[0], [x1, y1] = line.at(-1), length = Math.hypot(x1 - x0, y1 - y0);
  let most = near, at = 0;
  line.forEach(([x, y], i) => {
    const away = Math.abs((x1 - x0) * (y - y0) - (y1 - y0) * (x - x0)) / length;
    if (away > most) [most, at] = [away, i];
  });
  if (!at) return [line[0], line.at(-1)];
  return [...enough(line.slice(0, at + 1), near).slice(0, -1), ...enough(line.slice(at), near)];
}

const within = (value, [low, high]) => Math.min(Math.max(value, low), high);
const grainOf = size => 10 ** Math.floor(Math.log10(size / 2000));
const rounded = (value, grain) => Number((Math.round(value / grain) * grain).toPrecision(12));

class Drawing {
  constructor(place) {
    const told = JSON.parse(place.dataset.drawn), find = name => place.querySelector(name), around = place.closest(".of-drawn");
    Object.assign(this, {place, told, dots: [], points: [], group: find(".drawing-points"),
      words: find(".drawing-said"), warned: find(".drawing-warned"),
      text: around.querySelector("textarea"), seconds: around.querySelector(".field-seconds input"), end: 1});
    this.colours = {};
    this.picture = new Picture(find("canvas"), this.colours, TIME, told.label);
    for (const field of [this.text, this.seconds]) field.addEventListener("input", () => { if (!this.writing) this.read(); });
    this.text.addEventListener("change", () => this.remember("text"));
    followed(this.picture.canvas, {begin: event => this.press(event), move: event => this.pull(event), end: (event, lost) => this.lift(lost)});
    place.addEventListener("keydown", event => this.key(event));
    place.addEventListener("focusin", () => this.say());
    place.addEventListener("focusout", () => { past.by = ""; this.say(); });
    for (const [name, by] of [["back", -1], ["again", 1]]) find(`[data-do=${name}]`).addEventListener("click", () => this.go(by));
    const of = JSON.stringify([told.y, told.label]);
    if (past.of !== of) Object.assign(past, {texts: [], at: -1, of});
    this.remember("");
    this.read();
    new ResizeObserver(() => this.show()).observe(place);
  }

  // ---- the text and what can be taken back ----

  read() {
    const found = pointsOf(this.text.value), {y, rests} = this.told, wanted = Number(this.seconds.value.replace(",", "."));
    this.bad = !found;
    this.points = found || [];
    this.duration = wanted > 0 && Number.isFinite(wanted) ? wanted : 0;
    this.end = Math.max(this.duration, ...this.points.map(([t]) => t)) || 1;
    const room = ROOM * (y[1] - y[0]), levels = [...this.points.map(([, r]) => r), ...rests.map(r => within(r, [y[0] - 4 * room, y[1] + 4 * room]))];
    const low = Math.min(...levels, y[0]), high = Math.max(...levels, y[1]);
    this.span = [low - room, high + room];
    this.show();
  }

  write(by = "") {
    this.bad = false;
    this.put(this.points.map(([t, r]) => `${t} ${r}`).join("\n"));
    this.remember(by);
    this.show();
  }

  put(text) {
    this.writing = true;
    this.text.value = text;
    this.text.dispatchEvent(new Event("input", {bubbles: true}));
    this.writing = false;
  }

  // What one point is moved by keys, step after step, is taken back at once.
  remember(by) {
    const text = this.text.value;
    if (past.texts[past.at] !== text) {
      past.at += by && by === past.by && past.at > 0 ? 0 : 1;
      past.texts.splice(past.at, Infinity, text);
    }
    past.by = by;
    this.buttons();
  }

  go(by) {
    if (!(past.at + by in past.texts)) return;
    const i = this.dots.indexOf(document.activeElement);
    past.at += by;
    past.by = "";
    this.put(past.texts[past.at]);
    this.read();
    if (i >= 0) this.dots[Math.min(i, this.dots.length - 1)]?.focus();
    this.buttons();
  }

  buttons() {
    for (const [name, by] of [["back", -1], ["again", 1]]) {
      const button = this.place.querySelector(`[data-do=${name}]`), can = past.at + by in past.texts;
      button.setAttribute("aria-disabled", String(!can));  // one that is disabled would lose the focus
    }
  }

  // ---- the picture ----

  show() {
    const {picture, points, told, end, colours} = this;
    if (!picture.canvas.clientWidth) return;
    Object.assign(colours, coloursOf(this.place, ["ink", "rule"]));
    picture.begin([-MARGINS * end, (1 + MARGINS) * end], this.span);
    picture.band(told.y, "range");
    for (const level of told.rests) picture.curve(picture.x, [level, level], "limit");
    if (points.length) {
      const times = points.map(([t]) => t), levels = points.map(([, r]) => r);
      picture.curve([0, ...times, end], [levels[0], ...levels, levels.at(-1)], "reference");
    }
    this.group.hidden = Boolean(this.stroke);
    if (!this.stroke) this.put_dots();
    this.say();
  }

  put_dots() {
    const {dots, points, picture, span} = this;
    while (dots.length > points.length) dots.pop().remove();
    while (dots.length < points.length) this.add_dot();
    points.forEach((point, i) => {
      const [t, r] = point, dot = dots[i];
      dot.style.transform = `translate(${picture.across(t).toFixed(1)}px, ${picture.up(r).toFixed(1)}px)`;
      const said = {label: `Point ${i + 1} of ${points.length}`, valuetext: this.worded(point), valuenow: r, valuemin: span[0], valuemax: span[1]};
      for (const [name, value] of Object.entries(said)) dot.setAttribute(`aria-${name}`, String(value));
    });
  }

  add_dot() {
    const dot = document.createElement("span");
    Object.assign(dot, {className: "drawing-point", tabIndex: 0});
    dot.setAttribute("role", "slider");
    dot.setAttribute("aria-orientation", "vertical");
    const move = event => this.move(this.dots.indexOf(dot), ...this.picture.at(event));
    followed(dot, {begin() {}, move, end: () => this.write()});
    this.dots.push(dot);
    this.group.append(dot);
  }

  worded(point) {
    const [t, r] = this.near(...point);
    return [r, this.told.unit, "at", t, "s"].filter(word => word !== "").join(" ");
  }

  say() {
    const {points, told: {y}, duration} = this, i = this.dots.indexOf(document.activeElement);
    const count = points.length === 1 ? "1 point" : points.length ? `${points.length} points` : "";
    const said = points[i] ? `Point ${i + 1} of ${points.length}: ${this.worded(points[i])}` : count;
    const wrong = this.bad ? "The points below cannot be read: correct them there, or draw new ones."
      : duration && points.some(([t]) => t > duration) ? "Not all points lie within the duration."
        : points.some(([, r]) => r < y[0] || r > y[1]) ? "The reference leaves the identified range: nothing was measured there." : "";
    // A line of its own: what stands below must not move when a press takes the focus from a point.
    for (const [place, text] of [[this.words, said], [this.warned, wrong]]) if (place.textContent !== text) place.textContent = text;
  }

  // ---- the hand ----

  near(t, r) {  // in the picture, with as many digits as can be seen
    const {end, span} = this;
    return [Math.min(rounded(within(t, [0, end]), grainOf(end)), end), rounded(within(r, span), grainOf(span[1] - span[0]))];
  }

  move(i, t, r) {  // between its neighbours
    const {points, end} = this, grain = grainOf(end);
    const low = i ? points[i - 1][0] + grain : 0, high = i + 1 < points.length ? points[i + 1][0] - grain : end;
    points[i] = this.near(low > high ? points[i][0] : within(t, [low, high]), r);
    this.show();
  }

  press(event) {
    this.stroke = new Map();
    this.before = this.points;
    this.from = null;
    this.pull(event);
  }

  pull(event) {
    const {picture, stroke, from, before, span, end} = this, [t, level] = picture.at(event);
    const x = Math.round(picture.across(within(t, [0, end]))), r = within(level, span);
    const [x0, r0] = from || [x, r], toward = Math.sign(x - x0);
    stroke.set(x, r);
    for (let at = x0; at !== x; at += toward) stroke.set(at, r0 + (r - r0) * (at - x0) / (x - x0));
    this.from = [x, r];
    this.line = [...stroke].sort((a, b) => a[0] - b[0]);
    this.points = this.beside(before, this.line);
    this.show();
  }

  lift(lost) {
    const {line, before, picture} = this;
    this.stroke = null;
    if (lost) {
      this.points = before;
      this.show();
      return;
    }
    let points = [], near = NEAR;
    do {
      const kept = new Set(line.length > 1 ? enough(line.map(([x, r]) => [x, picture.up(r)]), near).map(([x]) => x) : [line[0][0]]);
      points = this.beside(before, line.filter(([x]) => kept.has(x)));
      near *= 2;
    } while (points.length > MOST && near < 1e4);
    this.points = points.length <= MOST ? points : before;
    this.write();
    const times = this.points.map(([t]) => Math.abs(t - picture.along(this.from[0])));
    this.dots[times.indexOf(Math.min(...times))].focus({preventScroll: true});  // keys go on from here
  }

  // What was drawn takes the place of all points in its time.
  beside(points, line) {
    const all = line.map(([x, r]) => this.near(this.picture.along(x), r)), grain = grainOf(this.end);
    const drawn = all.filter(([t], i) => !i || t > all[i - 1][0]);
    return [...points.filter(([t]) => t < drawn[0][0] - grain), ...drawn, ...points.filter(([t]) => t > drawn.at(-1)[0] + grain)];
  }

  // ---- keys ----

  key(event) {
    const name = event.key.toLowerCase(), i = this.dots.indexOf(event.target);
    if ((event.ctrlKey || event.metaKey) && "zy".includes(name)) {  // here it is the drawing that is taken back
      event.preventDefault();
      event.stopPropagation();
      return this.go(name === "y" || event.shiftKey ? 1 : -1);
    }
    if (i < 0 || event.ctrlKey || event.metaKey || event.altKey) return;
    const by = event.shiftKey ? 10 : 1, {points, span, end} = this, [t, r] = points[i];
    const across = by * ticks(0, end, STEPS).step, up = by * ticks(...span, STEPS).step;
    const moves = {ArrowUp: [t, r + up], ArrowDown: [t, r - up], ArrowRight: [t + across, r], ArrowLeft: [t - across, r],
      PageUp: [t, r + 10 * up / by], PageDown: [t, r - 10 * up / by], Home: [t, span[0]], End: [t, span[1]]};
    const done = moves[event.key] ? (this.move(i, ...moves[event.key]), this.write(`point ${i}`), true)
      : event.key === "Enter" || event.key === "Insert" ? this.insert(i)
        : event.key === "Delete" || event.key === "Backspace" ? this.remove(i)
          : event.key === "Escape" && (this.place.querySelector("[data-do=back]").focus(), true);
    if (done) event.preventDefault();
  }

  insert(i) {  // halfway to the next one; behind the last, halfway to the end
    const {points, end} = this, [t, r] = points[i], [after, level] = points[i + 1] || [end, r];
    if (points.length >= MOST || after - t < 4 * grainOf(end)) return true;
    points.splice(i + 1, 0, this.near((t + after) / 2, (r + level) / 2));
    this.write();
    this.dots[i + 1].focus();
    return true;
  }

  remove(i) {
    if (this.points.length === 1) return true;
    this.points.splice(i, 1);
    this.write();
    this.dots[Math.min(i, this.points.length - 1)].focus();
    return true;
  }
}

for (const query of ["(prefers-color-scheme: dark)", "print"]) window.matchMedia(query).addEventListener("change", () => last?.show());

export default place => { last = new Drawing(place); };
