// Draws a frame of the 3D view by WebGL 2: spheres that a shader computes per pixel, and transparent walls.

// Common to all shaders: positions relative to the eye, and the depth of a position.
const CAMERA = `#version 300 es
precision highp float;
uniform mat3 turn;
uniform vec3 target, low;
uniform vec2 focal, depth;
uniform float distance_, step_;
vec3 seen(vec3 grid) { return turn * (low + step_ * grid - target) - vec3(0, 0, distance_); }
vec4 projected(vec3 p) { return vec4(focal * p.xy, depth.x * p.z + depth.y, -p.z); }
`;
// A square perpendicular to the line of sight, which covers the sphere exactly.
const SPHERE_VERTEX = CAMERA + `
in vec3 position;
in float radius, level;
uniform float radiusStep;
uniform vec3 palette[9];
uniform bool isCategory;
out vec3 ray;
flat out vec3 center, color;
flat out float size;
void main() {
  size = radiusStep * radius;
  center = seen(position);
  float place = level * 8.0 / 255.0, away = dot(center, center);
  int lower = min(int(place), 7);
  color = isCategory ? palette[int(level) % 9] : mix(palette[lower], palette[lower + 1], place - float(lower));
  if (away < 4.0 * size * size || center.z > -size) { gl_Position = vec4(2, 2, 2, 1); return; }
  vec3 sight = center * inversesqrt(away);
  vec3 u = normalize(cross(sight, abs(sight.y) < 0.9 ? vec3(0, 1, 0) : vec3(1, 0, 0)));
  vec2 corner = 2.0 * vec2(gl_VertexID & 1, gl_VertexID >> 1) - 1.0;
  ray = center + size * sqrt(away / (away - size * size)) * (corner.x * u + corner.y * cross(u, sight));
  gl_Position = projected(ray);
}`;
const SPHERE_FRAGMENT = CAMERA + `
in vec3 ray;
flat in vec3 center, color;
flat in float size;
out vec4 shown;
void main() {
  vec3 direction = normalize(ray);
  float along = dot(direction, center);
  vec3 offset = along * direction - center;
  float half_ = size * size - dot(offset, offset);
  if (half_ < 0.0) discard;
  vec3 hit = (along - sqrt(half_)) * direction;
  vec4 clip = projected(hit);
  gl_FragDepth = 0.5 * clip.z / clip.w + 0.5;
  float light = 0.3 + 0.75 * max(dot((hit - center) / size, normalize(vec3(0.3, 0.5, 0.8))), 0.0);
  shown = vec4(light * color, 1);
}`;
const WALL_VERTEX = CAMERA + `
in vec3 position;
out vec3 place;
void main() { place = low + step_ * position; gl_Position = projected(seen(position)); }`;
const WORN_VERTEX = CAMERA + `
in vec3 position;
in float level;
uniform vec3 palette[9];
out vec3 place;
flat out vec3 color;
void main() {
  float along = level * 8.0 / 255.0;
  int lower = min(int(along), 7);
  color = mix(palette[lower], palette[lower + 1], along - float(lower));
  place = low + step_ * position;
  gl_Position = projected(seen(position));
}`;
const WORN_FRAGMENT = CAMERA + `
in vec3 place;
flat in vec3 color;
uniform vec3 boxLow, boxHigh;
out vec4 shown;
void main() {
  if (any(lessThan(place, boxLow)) || any(greaterThan(place, boxHigh))) discard;
  shown = vec4(color, 1);
}`;
const WALL_FRAGMENT = CAMERA + `
in vec3 place;
uniform vec3 boxLow, boxHigh;
uniform vec4 color;
out vec4 shown;
void main() {
  if (any(lessThan(place, boxLow)) || any(greaterThan(place, boxHigh))) discard;
  shown = color;
}`;

// A compiled program, with the locations of its uniforms and attributes by name.
function programOf(gl, vertex, fragment) {
  const program = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) throw Error(gl.getProgramInfoLog(program));
  return {program, uniform: (name) => gl.getUniformLocation(program, name),
    attribute: (name) => gl.getAttribLocation(program, name)};
}

const components = (color) => [1, 3, 5].map((k) => parseInt(color.slice(k, k + 2), 16) / 255);

// Draws frames of `header` with arrays in `buffer` on a canvas.
class Drawing {
  constructor(gl, header, buffer) {
    Object.assign(this, {gl, header, buffer, buffers: new Map()});
    this.spheres = programOf(gl, SPHERE_VERTEX, SPHERE_FRAGMENT);
    this.walls = programOf(gl, WALL_VERTEX, WALL_FRAGMENT);
    this.worn = programOf(gl, WORN_VERTEX, WORN_FRAGMENT);
    gl.enable(gl.DEPTH_TEST);
    gl.blendFuncSeparate(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA, gl.ONE, gl.ONE_MINUS_SRC_ALPHA);  // premultiplied
  }
  // Bind the buffer with an array of the data; each is copied to the device once.
  bind(reference, target = this.gl.ARRAY_BUFFER) {
    const key = `${target} ${reference.offset}`;
    if (!this.buffers.has(key)) {
      const found = this.gl.createBuffer();
      this.buffers.set(key, found);
      this.gl.bindBuffer(target, found);
      const array = new globalThis[reference.type](this.buffer, reference.offset, reference.length);
      this.gl.bufferData(target, array, this.gl.STATIC_DRAW);
    }
    this.gl.bindBuffer(target, this.buffers.get(key));
  }
  attribute(found, name, reference, size, kind, divisor) {
    const {gl} = this, place = found.attribute(name);
    this.bind(reference);
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, size, kind, false, 0, 0);
    gl.vertexAttribDivisor(place, divisor);
  }
  use(found, orbit, grid) {
    for (let k = 0; k < 3; k++) this.gl.disableVertexAttribArray(k);
    this.gl.useProgram(found.program);
    orbit.apply(this.gl, found);
    this.gl.uniform3fv(found.uniform("low"), grid.low);
    this.gl.uniform1f(found.uniform("step_"), grid.step);
  }
  draw(orbit, frame, color, hasWalls, edgeColor, wallColor) {
    const {gl, header} = this;
    gl.viewport(0, 0, gl.drawingBufferWidth, gl.drawingBufferHeight);
    gl.clearColor(0, 0, 0, 0);
    gl.depthMask(true);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    this.drawSpheres(orbit, header.frames[frame], color);
    const drawn = hasWalls ? header.frames[frame].walls : [];
    if (wallColor >= 0) for (const wall of drawn) if (wall.worn) this.drawWorn(orbit, wall, wallColor);
    for (const wall of drawn) this.drawWall(orbit, wall, edgeColor);
  }
  drawSpheres(orbit, entry, color) {
    const {gl, header, spheres} = this, quantity = header.quantities[color];
    if (!entry.count) return;
    this.use(spheres, orbit, header.grid);
    gl.disable(gl.BLEND);
    gl.uniform1f(spheres.uniform("radiusStep"), header.radiusStep);
    gl.uniform3fv(spheres.uniform("palette"), quantity.palette.flatMap(components));
    gl.uniform1i(spheres.uniform("isCategory"), quantity.names ? 1 : 0);
    this.attribute(spheres, "position", entry.position, 3, gl.UNSIGNED_SHORT, 1);
    this.attribute(spheres, "radius", entry.radius, 1, gl.UNSIGNED_SHORT, 1);
    this.attribute(spheres, "level", entry.colors[color], 1, gl.UNSIGNED_BYTE, 1);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, entry.count);
  }
  // The worn triangles, opaque: each has three points and the same level at all of them.
  drawWorn(orbit, wall, wallColor) {
    const {gl, worn} = this;
    this.use(worn, orbit, wall.grid);
    gl.disable(gl.BLEND);
    gl.uniform3fv(worn.uniform("boxLow"), wall.box[0]);
    gl.uniform3fv(worn.uniform("boxHigh"), wall.box[1]);
    gl.uniform3fv(worn.uniform("palette"), this.header.wallQuantities[wallColor].palette.flatMap(components));
    this.attribute(worn, "position", wall.worn.points, 3, gl.UNSIGNED_SHORT, 0);
    this.attribute(worn, "level", wall.worn.levels[wallColor], 1, gl.UNSIGNED_BYTE, 0);
    gl.drawArrays(gl.TRIANGLES, 0, wall.worn.levels[wallColor].length);
  }
  drawWall(orbit, wall, edgeColor) {
    const {gl, walls} = this;
    this.use(walls, orbit, wall.grid);
    gl.enable(gl.BLEND);
    gl.depthMask(false);
    gl.uniform3fv(walls.uniform("boxLow"), wall.box[0]);
    gl.uniform3fv(walls.uniform("boxHigh"), wall.box[1]);
    this.attribute(walls, "position", wall.points, 3, gl.UNSIGNED_SHORT, 0);
    for (const [mode, part, opacity] of [[gl.TRIANGLES, wall.triangles, 0.12], [gl.LINES, wall.edges, 0.7]]) {
      gl.uniform4f(walls.uniform("color"), ...edgeColor, opacity);
      this.bind(part, gl.ELEMENT_ARRAY_BUFFER);
      gl.drawElements(mode, part.length, gl.UNSIGNED_INT, 0);
    }
  }
}
