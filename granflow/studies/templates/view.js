// The interactive 3D view: camera and controls.

const OPENING = 24 * Math.PI / 180, TURN = 0.008, ZOOM = 0.0015, STEP = 0.1, MOST_PIXELS = 2;
const PLAY_INTERVAL = 150;  // time between frames [ms]
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const plus = (a, b, factor = 1) => a.map((value, k) => value + factor * b[k]);
const unit = (a) => a.map((value) => value / Math.hypot(...a));
const clamp = (value, low, high) => Math.min(Math.max(value, low), high);

// Camera that turns around a target; `up` is upward in the picture.
class Orbit {
  constructor(header) {
    Object.assign(this, {up: header.up, home: header.toward, extent: header.extent});
    this.side = unit(cross(this.up, Math.abs(this.up[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0]));
    this.front = cross(this.side, this.up);
    this.aspect = 1;
    this.reset();
  }
  reset() {
    const size = this.extent[0].map((low, k) => this.extent[1][k] - low);
    this.target = plus(this.extent[0], size, 0.5);
    this.azimuth = Math.atan2(dot(this.home, this.side), dot(this.home, this.front));
    this.elevation = Math.asin(clamp(dot(this.home, this.up), -1, 1));
    const [right, up, toward] = this.axes(), slope = Math.tan(OPENING / 2);
    const corners = [...Array(8).keys()].map((k) => size.map((length, axis) => (k >> axis & 1 ? 0.5 : -0.5) * length));
    this.size = Math.hypot(...size);
    this.distance = 1.05 * Math.max(...corners.map((each) => dot(each, toward)
      + Math.max(Math.abs(dot(each, right)) / Math.min(this.aspect, 3), Math.abs(dot(each, up))) / slope));
  }
  axes() {
    const level = plus(this.front.map((x) => x * Math.cos(this.azimuth)), this.side, Math.sin(this.azimuth));
    const toward = plus(level.map((x) => x * Math.cos(this.elevation)), this.up, Math.sin(this.elevation));
    const right = unit(cross(this.up, level));
    return [right, cross(toward, right), toward];
  }
  turn(x, y) {
    this.azimuth -= x;
    this.elevation = clamp(this.elevation + y, -1.57, 1.57);
  }
  zoom(factor) { this.distance = clamp(this.distance * factor, 0.02 * this.size, 50 * this.size); }
  shift(x, y, height) {
    const [right, up] = this.axes(), length = 2 * this.distance * Math.tan(OPENING / 2) / height;
    this.target = plus(plus(this.target, right, -x * length), up, y * length);
  }
  apply(gl, found) {
    const axes = this.axes(), f = 1 / Math.tan(OPENING / 2);
    const far = this.distance + 4 * this.size, near = Math.max(this.distance - 4 * this.size, 0.002 * this.distance);
    gl.uniformMatrix3fv(found.uniform("turn"), true, axes.flat());
    gl.uniform3fv(found.uniform("target"), this.target);
    gl.uniform2f(found.uniform("focal"), f / this.aspect, f);
    gl.uniform2f(found.uniform("depth"), -(far + near) / (far - near), -2 * far * near / (far - near));
    gl.uniform1f(found.uniform("distance_"), this.distance);
  }
}

// Pointers, wheel and keys turn, shift and zoom. Before the first click, wheel and vertical swipes scroll the page.
function addControls(canvas, orbit, redraw) {
  const pointers = new Map(), spread = () => {
    const [a, b] = [...pointers.values()];
    return {x: (a.x + b.x) / 2, y: (a.y + b.y) / 2, length: Math.hypot(a.x - b.x, a.y - b.y)};
  };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, {x: event.clientX, y: event.clientY});
  });
  canvas.addEventListener("pointermove", (event) => {
    const last = pointers.get(event.pointerId), now = {x: event.clientX, y: event.clientY};
    if (!last) return;
    const before = pointers.size === 2 ? spread() : null;
    pointers.set(event.pointerId, now);
    if (before) {
      const after = spread();
      orbit.zoom(before.length / Math.max(after.length, 1));
      orbit.shift(after.x - before.x, after.y - before.y, canvas.clientHeight);
    } else if (event.buttons & 6 || event.shiftKey) {
      orbit.shift(now.x - last.x, now.y - last.y, canvas.clientHeight);
    } else {
      orbit.turn(TURN * (now.x - last.x), TURN * (now.y - last.y));
    }
    redraw();
  });
  for (const name of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(name, (event) => pointers.delete(event.pointerId));
  }
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("wheel", (event) => {
    if (document.activeElement !== canvas) return;
    event.preventDefault();
    orbit.zoom(Math.exp(ZOOM * event.deltaY * (event.deltaMode ? 20 : 1)));
    redraw();
  }, {passive: false});
  const keys = {ArrowLeft: () => orbit.turn(-STEP, 0), ArrowRight: () => orbit.turn(STEP, 0),
    ArrowUp: () => orbit.turn(0, STEP), ArrowDown: () => orbit.turn(0, -STEP),
    "+": () => orbit.zoom(1 - STEP), "-": () => orbit.zoom(1 + STEP), "0": () => orbit.reset()};
  canvas.addEventListener("keydown", (event) => {
    if (!keys[event.key] || event.ctrlKey || event.metaKey) return;
    event.preventDefault();
    keys[event.key]();
    redraw();
  });
}

// Legend of a quantity: a bar with its limits, or the name of each category.
function legendOf(quantity) {
  const swatch = (background) => Object.assign(document.createElement("i"), {style: `background: ${background}`});
  if (quantity.names) return quantity.names.flatMap(([name, color]) => [swatch(color), ` ${name} `]);
  const bar = swatch(`linear-gradient(to right, ${quantity.palette.join(", ")})`);
  bar.className = "bar";
  return [quantity.labels[0] + " ", bar, " " + quantity.labels[1]];
}

async function showView(figure) {
  const {header, data} = JSON.parse(figure.querySelector("script").textContent);
  const part = (name) => figure.querySelector(name), canvas = part("canvas");
  const gl = canvas.getContext("webgl2", {antialias: true});
  if (!gl) throw Error("this browser has no WebGL 2");
  const buffer = await inflated(data), orbit = new Orbit(header);
  const color = part("select"), time = part("input[type=range]"), walls = part("input[type=checkbox]");
  const worn = part("select.worn");  // only in runs with wear
  let drawing = new Drawing(gl, header, buffer), isDue = false, player = 0;
  function draw() {
    isDue = false;
    const edge = getComputedStyle(canvas).color.match(/[\d.]+/g).slice(0, 3).map((value) => value / 255);
    drawing.draw(orbit, +time.value, +color.value, walls.checked, edge, worn ? +worn.value : -1);
  }
  const redraw = () => { if (!isDue) requestAnimationFrame(draw); isDue = true; };
  function update() {
    part("output").textContent = header.frames[time.value].time;
    part(".legend").replaceChildren(...legendOf(header.quantities[color.value]));
    if (worn) part(".legend.worn").replaceChildren(...(worn.value < 0 ? [] : legendOf(header.wallQuantities[worn.value])));
    redraw();
  }
  function play() {
    part(".play").textContent = player ? "play" : "stop";
    if (player) { clearInterval(player); player = 0; return; }
    player = setInterval(() => { time.value = (+time.value + 1) % header.frames.length; update(); }, PLAY_INTERVAL);
  }
  let isFitted = false;
  new ResizeObserver(() => {
    const scale = Math.min(devicePixelRatio, MOST_PIXELS);
    canvas.width = canvas.clientWidth * scale;
    canvas.height = canvas.clientHeight * scale;
    orbit.aspect = canvas.width / canvas.height || 1;
    if (!isFitted) orbit.reset();
    isFitted = true;
    draw();
  }).observe(canvas);
  header.quantities.forEach((each, k) => color.add(new Option(each.title, k)));
  if (worn) {
    header.wallQuantities.forEach((each, k) => worn.add(new Option(each.title, k)));
    worn.add(new Option("plain", -1));
    worn.addEventListener("input", update);
  }
  const counts = header.frames.map((each) => each.count), most = Math.max(...counts);
  time.max = counts.length - 1;
  time.value = counts.findLastIndex((count) => 2 * count >= most);
  for (const input of [color, time, walls]) input.addEventListener("input", update);
  part(".play").onclick = play;
  part(".reset").onclick = () => { orbit.reset(); redraw(); };
  canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
  canvas.addEventListener("webglcontextrestored", () => { drawing = new Drawing(gl, header, buffer); redraw(); });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);
  addControls(canvas, orbit, redraw);
  update();
}

for (const figure of document.querySelectorAll("figure.view")) {
  showView(figure).catch((error) => {
    figure.classList.add("failed");
    figure.querySelector(".problem").textContent = `The 3D view cannot be shown: ${error.message}. `
      + "The pictures below show the run, and ParaView opens particles.pvd and walls.pvd.";
  });
}
