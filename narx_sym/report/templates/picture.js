// Stands behind `LOOKS`. What pictures share that move with the hand: axes and curves on a canvas, and where a pointer is in them.
const MARGIN = {left: 58, right: 8, top: 8, bottom: 36};

function ticks(low, high, most) {
  const rough = (high - low) / most, power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map(f => f * power).find(s => s >= rough), found = [];
  for (let i = Math.ceil(low / step); i * step <= high; i++) found.push(i * step);
  return {step, found};
}

class Picture {
  constructor(canvas, colours, xLabel, yLabel) {
    Object.assign(this, {canvas, colours, xLabel, yLabel, pen: canvas.getContext("2d")});
  }

  begin(x, y, box = this.canvas.getBoundingClientRect(), scale = window.devicePixelRatio || 1) {
    const pen = this.pen;
    const width = Math.round(box.width * scale), height = Math.round(box.height * scale);
    if (this.canvas.width !== width || this.canvas.height !== height) Object.assign(this.canvas, {width, height});
    pen.setTransform(scale, 0, 0, scale, 0, 0);
    pen.clearRect(0, 0, box.width, box.height);
    Object.assign(this, {x, y, left: MARGIN.left, right: box.width - MARGIN.right, top: MARGIN.top,
      bottom: box.height - (this.xLabel ? MARGIN.bottom : MARGIN.top)});
    this.axes();
  }

  across(value) { return this.left + (value - this.x[0]) / (this.x[1] - this.x[0]) * (this.right - this.left); }

  up(value) {  // what leaves the picture stops a little outside
    const at = this.bottom - (value - this.y[0]) / (this.y[1] - this.y[0]) * (this.bottom - this.top);
    return Math.min(Math.max(at, -50), this.bottom + 50);
  }

  along(at) { return this.x[0] + (at - this.left) / (this.right - this.left) * (this.x[1] - this.x[0]); }

  at(event) {  // the values where a pointer is, also beside the picture
    const box = this.canvas.getBoundingClientRect(), {y, top, bottom} = this;
    return [this.along(event.clientX - box.left), y[1] - (event.clientY - box.top - top) / (bottom - top) * (y[1] - y[0])];
  }

  // What stays while a parameter moves is drawn once: the axes, and `rest`.
  background(key, x, y, rest) {
    const box = this.canvas.getBoundingClientRect(), scale = window.devicePixelRatio || 1;
    const whole = [key, x, y, box.width, box.height, scale].join();
    if (whole !== this.key) {
      this.begin(x, y, box, scale);
      rest();
      const kept = this.kept = this.kept || document.createElement("canvas");
      Object.assign(kept, {width: this.canvas.width, height: this.canvas.height});
      kept.getContext("2d").drawImage(this.canvas, 0, 0);
      this.key = whole;
    }
    this.pen.setTransform(1, 0, 0, 1, 0, 0);
    this.pen.clearRect(0, 0, this.canvas.width, this.canvas.height);
    this.pen.drawImage(this.kept, 0, 0);
    this.pen.setTransform(scale, 0, 0, scale, 0, 0);
  }

  axes() {
    const pen = this.pen, {left, right, top, bottom} = this;
    pen.font = "12px system-ui, sans-serif";
    pen.lineWidth = 1;
    const label = (value, step) => Number(value.toPrecision(12)).toLocaleString("en", {useGrouping: false,
      maximumFractionDigits: Math.min(12, Math.max(0, -Math.floor(Math.log10(step) + 1e-9)))});
    const powers = step => step < 1e-3 || Math.max(...this.y.map(Math.abs)) >= 1e6;
    const apart = Math.max(14, Math.min(35, (bottom - top) / 5));
    const vertical = ticks(...this.y, (bottom - top) / apart);
    pen.textAlign = "right";
    pen.textBaseline = "middle";
    for (const value of vertical.found) {
      this.rule(left, this.up(value), right, this.up(value));
      pen.fillStyle = this.colours.ink;
      pen.fillText(powers(vertical.step) && value ? Number(value.toPrecision(4)).toExponential() : label(value, vertical.step), left - 5, this.up(value));
    }
    const horizontal = ticks(...this.x, Math.max(5, (right - left) / 70));
    pen.textAlign = "center";
    pen.textBaseline = "top";
    for (const value of horizontal.found) {
      this.rule(this.across(value), top, this.across(value), bottom);
      pen.fillStyle = this.colours.ink;
      if (this.xLabel) pen.fillText(label(value, horizontal.step), this.across(value), bottom + 4);
    }
    if (this.xLabel) pen.fillText(this.xLabel, (left + right) / 2, bottom + 19);
    pen.save();
    pen.translate(9, (top + bottom) / 2);
    pen.rotate(-Math.PI / 2);
    pen.textBaseline = "middle";
    pen.fillText(this.yLabel, 0, 0);
    pen.restore();
  }

  rule(x0, y0, x1, y1) {
    const pen = this.pen;
    pen.strokeStyle = this.colours.rule;
    pen.globalAlpha = 0.5;
    pen.beginPath();
    pen.moveTo(Math.round(x0) + 0.5, Math.round(y0) + 0.5);
    pen.lineTo(Math.round(x1) + 0.5, Math.round(y1) + 0.5);
    pen.stroke();
    pen.globalAlpha = 1;
  }

  clipped(draw) {
    const pen = this.pen;
    pen.save();
    pen.beginPath();
    pen.rect(this.left, this.top, this.right - this.left, this.bottom - this.top);
    pen.clip();
    draw(pen);
    pen.restore();
  }

  stroked(role, path) {
    this.clipped(pen => {
      const look = LOOKS[role];
      pen.strokeStyle = look.colour;
      pen.lineWidth = look.width;
      pen.setLineDash(look.dash);
      pen.lineJoin = "round";
      pen.beginPath();
      path(pen);
      pen.stroke();
    });
  }

  curve(xs, ys, role) {
    this.stroked(role, pen => {
      for (let k = 0; k < ys.length; k++) {  // with a gap where a value is none
        const kind = Number.isFinite(xs[k - 1] + ys[k - 1]) ? "lineTo" : "moveTo";
        if (Number.isFinite(xs[k] + ys[k])) pen[kind](this.across(xs[k]), this.up(ys[k]));
      }
    });
  }

  filled(xs, ys, role) {
    this.clipped(pen => {
      pen.fillStyle = LOOKS[role].colour;
      pen.globalAlpha = LOOKS[role].alpha;
      pen.beginPath();
      for (let k = 0; k < ys.length; k++) pen.lineTo(this.across(xs[k]), this.up(ys[k]));
      pen.fill();
    });
  }

  dots(xs, ys, role) {
    this.clipped(pen => {
      const {colour, dot} = LOOKS[role];
      pen.fillStyle = colour;
      pen.beginPath();
      for (let k = 0; k < ys.length; k++) if (Number.isFinite(xs[k] + ys[k])) {
        pen.rect(this.across(xs[k]) - dot / 2, this.up(ys[k]) - dot / 2, dot, dot);
      }
      pen.fill();
    });
  }

  area(left, top, right, bottom, role) {
    this.clipped(pen => {
      pen.fillStyle = LOOKS[role].colour;
      pen.globalAlpha = LOOKS[role].alpha;
      pen.fillRect(left, top, right - left, bottom - top);
    });
  }

  band([low, high], role) { this.area(this.left, this.up(high), this.right, this.up(low), role); }

  span(low, high, role) { this.area(this.across(low), this.top, this.across(high), this.bottom, role); }
}

// A pointer that is pressed on an element is followed until it is let go, wherever it goes.
function followed(place, {begin, move, end}) {
  let on = false;
  place.addEventListener("pointerdown", event => {
    if (event.button || on) return;
    on = true;
    place.setPointerCapture(event.pointerId);
    begin(event);
  });
  place.addEventListener("pointermove", event => { if (on) move(event); });
  for (const kind of ["pointerup", "pointercancel"]) place.addEventListener(kind, event => {
    if (!on) return;
    on = false;
    end(event, kind === "pointercancel");
  });
}

function coloursOf(place, names) {
  const style = getComputedStyle(place);
  return Object.fromEntries(names.map(name => [name, style.getPropertyValue(`--${name}`).trim()]));
}
