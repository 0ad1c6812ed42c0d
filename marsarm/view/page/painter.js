// Drawing of a scene with WebGL 2: lit triangles with shadows, the outline of a second arm, trail and force.
"use strict";

// a vertex has its colour and the number of its body: one call draws a whole arm
const LIT_VERTEX = `#version 300 es
layout(location=0) in vec3 p; layout(location=1) in vec3 n; layout(location=2) in vec4 c;
uniform mat4 models[BODIES], view, sunStill, sunMoving; out vec3 normal, colour, place, inStill, inMoving; out float depth;
void main() { mat4 model = models[int(c.w)]; vec4 w = model * vec4(p, 1.0); gl_Position = view * w; depth = gl_Position.w;
  normal = mat3(model) * n; colour = c.rgb; place = w.xyz;
  inStill = (sunStill * w).xyz * 0.5 + 0.5; inMoving = (sunMoving * w).xyz * 0.5 + 0.5; }`;
const LIT_FRAGMENT = `#version 300 es
precision highp float; precision highp sampler2DShadow;
in vec3 normal, colour, place, inStill, inMoving; in float depth; out vec4 outColour;
uniform vec3 sun; uniform bool isGround; uniform sampler2DShadow still, moving; uniform sampler2D sand;
float free(sampler2DShadow map, vec3 at) {
  return all(equal(at, clamp(at, 0.0, 1.0))) ? texture(map, at) : 1.0; }
void main() {
  vec3 n = normalize(normal); float facing = dot(n, sun), light = 0.46 + 0.13 * n.z;
  if (facing > 0.0) light += 0.56 * facing * free(still, inStill) * free(moving, inMoving);
  if (isGround) light *= 0.82 + 0.36 * mix(texture(sand, place.xy * 0.9).r, texture(sand, place.xy * 0.13).r, 0.5);
  outColour = vec4(mix(vec3(0.84, 0.70, 0.55), colour * light, exp(-depth / 150.0)), 1.0); }`;
const PLAIN_VERTEX = `#version 300 es
layout(location=0) in vec3 p; layout(location=2) in vec4 c; uniform mat4 models[BODIES], view; uniform vec2 shift; uniform float size;
void main() { gl_Position = view * models[int(c.w)] * vec4(p, 1.0); gl_Position.xy += shift * gl_Position.w; gl_PointSize = size; }`;
const PLAIN_FRAGMENT = `#version 300 es
precision lowp float; uniform vec3 tint; out vec4 outColour; void main() { outColour = vec4(tint, 1.0); }`;
const STILL = { centre: [0.7, 0, 0.6], radius: 3.2, side: 2048 }; // in metres: rover, rock and reach of the arm
const MOVING = { centre: [1.2, -0.2, 0.9], radius: 2.3, side: 1024 };
const IDENTITY = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];
const OUTLINE = [90, 210, 330].map((angle) => angle * (Math.PI / 180)); // directions in which a shape grows on all sides
const OUTLINE_PX = 2;

class Painter {
  constructor(canvas, run, arrays) {
    this.canvas = canvas;
    this.isSoftware = isSoftware();
    const gl = canvas.getContext("webgl2", { antialias: !this.isSoftware, alpha: true, stencil: true });
    if (!gl) throw new Error("This browser has no WebGL 2, which the scene needs.");
    Object.assign(this, { gl, looks: run.looks, coarseness: 1 });
    this.bodies = run.carriers.length;
    this.plain = this.compile(PLAIN_VERTEX, PLAIN_FRAGMENT, ["models", "view", "shift", "size", "tint"]);
    this.lit = this.compile(LIT_VERTEX, LIT_FRAGMENT, ["models", "view", "sunStill", "sunMoving", "sun", "isGround", "still", "moving", "sand"]);
    gl.uniform3fv(this.lit.sun, unit(SUN));
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.CULL_FACE);
    gl.stencilOp(gl.KEEP, gl.KEEP, gl.REPLACE);
    gl.polygonOffset(2.5, 4); // of shadows, so that no surface shades itself
    this.arm = this.mesh(arrays, run.parts.filter((part) => part.carrier >= 0));
    this.ground = this.mesh(arrays, run.parts.filter((part) => part.is_ground));
    this.still = this.mesh(arrays, run.parts.filter((part) => part.carrier < 0 && !part.is_ground));
    this.arrow = this.meshOf(...arrowTriangles(run.looks.arrow));
    this.line = gl.createVertexArray();
    gl.vertexAttrib4f(2, 0, 0, 0, 0); // points of the line, which have no colour and no body, belong to the first one
    this.lineBuffer = gl.createBuffer();
    this.stillShadow = this.shadow("still", "sunStill", 0, STILL);
    this.movingShadow = this.shadow("moving", "sunMoving", 1, MOVING);
    this.addSand();
    this.cast(this.stillShadow, [this.still, this.ground], IDENTITY);
  }

  compile(vertex, fragment, names) {
    const gl = this.gl, program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text.replace("BODIES", Math.max(this.bodies, 1)));
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
    gl.useProgram(program);
    return { program, ...Object.fromEntries(names.map((name) => [name, gl.getUniformLocation(program, name)])) };
  }

  /** Make a map of what the sun sees first in a sphere. */
  shadow(sampler, matrixName, unitNumber, { centre, radius, side }) {
    const gl = this.gl, texture = gl.createTexture(), frame = gl.createFramebuffer(), matrix = sunView(centre, radius);
    gl.activeTexture(gl.TEXTURE0 + unitNumber);
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.DEPTH_COMPONENT24, side, side);
    const settings = { MIN_FILTER: gl.LINEAR, MAG_FILTER: gl.LINEAR, WRAP_S: gl.CLAMP_TO_EDGE, WRAP_T: gl.CLAMP_TO_EDGE, COMPARE_MODE: gl.COMPARE_REF_TO_TEXTURE };
    for (const [name, value] of Object.entries(settings)) gl.texParameteri(gl.TEXTURE_2D, gl["TEXTURE_" + name], value);
    gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.DEPTH_ATTACHMENT, gl.TEXTURE_2D, texture, 0);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.uniform1i(this.lit[sampler], unitNumber);
    gl.uniformMatrix4fv(this.lit[matrixName], false, matrix);
    return { frame, side, matrix };
  }

  /** Draw meshes with the matrices of their bodies into a map of shadows. */
  cast({ frame, side, matrix }, meshes, models) {
    const gl = this.gl;
    gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
    gl.viewport(0, 0, side, side);
    gl.clear(gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.POLYGON_OFFSET_FILL);
    this.use(this.plain, matrix);
    for (const mesh of meshes) this.draw(mesh, models);
    gl.disable(gl.POLYGON_OFFSET_FILL);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
  }

  /** Make the grain of the ground: the same noise each time, with finer and finer copies for what is far. */
  addSand() {
    const gl = this.gl, side = 256;
    let state = 1;
    const grain = Uint8Array.from({ length: side * side }, () => { state = (state * 48271) % 2147483647; return state & 255; });
    gl.activeTexture(gl.TEXTURE2);
    gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.R8, side, side, 0, gl.RED, gl.UNSIGNED_BYTE, grain);
    gl.generateMipmap(gl.TEXTURE_2D);
    gl.uniform1i(this.lit.sand, 2);
  }

  /** Make one mesh of parts of several colours. */
  mesh(arrays, parts) {
    const p = [], c = [], faces = [];
    for (const { carrier, vertices: [start, count], faces: [first, length], rgb } of parts) {
      const base = p.length / 3;
      for (let i = 3 * start; i < 3 * (start + count); i++) p.push(arrays.vertices[i]);
      for (let i = 0; i < count; i++) c.push(...rgb, Math.max(carrier, 0));
      for (let i = 3 * first; i < 3 * (first + length); i++) faces.push(base + arrays.faces[i]);
    }
    return this.meshOf(p, c, faces);
  }

  meshOf(p, c, faces) {
    const gl = this.gl, array = gl.createVertexArray();
    gl.bindVertexArray(array);
    [p, normalsOf(p, faces), c].forEach((values, location) => {
      gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
      gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(values), gl.STATIC_DRAW);
      gl.enableVertexAttribArray(location);
      gl.vertexAttribPointer(location, location === 2 ? 4 : 3, gl.FLOAT, false, 0, 0);
    });
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, new Uint32Array(faces), gl.STATIC_DRAW);
    return { array, count: faces.length };
  }

  /** Draw the scene with the arm at these matrices of its bodies. */
  drawScene(view, models) {
    const gl = this.gl, ratio = Math.min(window.devicePixelRatio || 1, 2) / this.coarseness;
    const width = Math.round(this.canvas.clientWidth * ratio), height = Math.round(this.canvas.clientHeight * ratio);
    if (this.canvas.width !== width || this.canvas.height !== height) Object.assign(this.canvas, { width, height });
    this.cast(this.movingShadow, [this.arm], models);
    gl.viewport(0, 0, width, height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT | gl.STENCIL_BUFFER_BIT);
    this.view = view(width / height);
    this.pixel = [(2 * ratio) / width, (2 * ratio) / height];
    this.use(this.lit, this.view);
    gl.uniform1i(this.lit.isGround, 0);
    // what stands in front comes first: what it hides is not shaded
    this.draw(this.arm, models);
    this.draw(this.still, IDENTITY);
    gl.uniform1i(this.lit.isGround, 1);
    this.draw(this.ground, IDENTITY);
    this.use(this.plain, this.view);
    gl.uniform1f(this.plain.size, Math.max(3 * ratio, 2));
  }

  use(program, view) {
    this.gl.useProgram(program.program);
    this.gl.uniformMatrix4fv(program.view, false, view);
    this.program = program;
  }

  draw(mesh, models) {
    const gl = this.gl;
    gl.uniformMatrix4fv(this.program.models, false, models);
    gl.bindVertexArray(mesh.array);
    gl.drawElements(gl.TRIANGLES, mesh.count, gl.UNSIGNED_INT, 0);
  }

  /** Draw the outline of an arm over all else: its shape, grown by pixels, less the shape. */
  drawOutline(models) {
    const gl = this.gl;
    const drawShape = (x, y) => {
      gl.uniform2f(this.plain.shift, x * this.pixel[0], y * this.pixel[1]);
      this.draw(this.arm, models);
    };
    gl.uniform3fv(this.plain.tint, this.looks.rgb.ghost);
    gl.disable(gl.DEPTH_TEST);
    gl.enable(gl.STENCIL_TEST);
    gl.colorMask(false, false, false, false);
    gl.stencilFunc(gl.ALWAYS, 1, 255);
    drawShape(0, 0);
    gl.colorMask(true, true, true, true);
    gl.stencilFunc(gl.NOTEQUAL, 1, 255);
    for (const angle of OUTLINE) drawShape(OUTLINE_PX * Math.cos(angle), OUTLINE_PX * Math.sin(angle));
    gl.uniform2f(this.plain.shift, 0, 0);
    gl.disable(gl.STENCIL_TEST);
    gl.enable(gl.DEPTH_TEST);
  }

  /** Draw the force on the tool, through which it is seen, and which is seen through it. */
  drawForce(tool, force, size) {
    const { gl, looks: { arrow, rgb } } = this;
    const length = Math.min(arrow.shortest_m + arrow.m_per_N * size, arrow.longest_m), x = force.map((v) => v / size);
    const y = unit(cross(Math.abs(x[2]) < 0.9 ? [0, 0, 1] : [1, 0, 0], x)), z = cross(x, y);
    const columns = [[x, length], [y, 1], [z, 1]].flatMap(([axis, s]) => [...axis.map((v) => v * s), 0]);
    gl.disable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    gl.blendColor(0, 0, 0, 0.5);
    gl.blendFunc(gl.CONSTANT_ALPHA, gl.ONE_MINUS_CONSTANT_ALPHA);
    gl.uniform3fv(this.plain.tint, rgb.force);
    this.draw(this.arrow, [...columns, ...tool, 1]);
    gl.disable(gl.BLEND);
    gl.enable(gl.DEPTH_TEST);
  }

  /** Take the points of the line. */
  setLine(points) {
    const gl = this.gl;
    gl.bindVertexArray(this.line);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.lineBuffer);
    gl.bufferData(gl.ARRAY_BUFFER, points, gl.DYNAMIC_DRAW);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0);
  }

  /** Draw the points of the line from one index to before another. */
  drawLine(first, end) {
    const gl = this.gl;
    gl.bindVertexArray(this.line);
    gl.uniformMatrix4fv(this.plain.models, false, IDENTITY);
    gl.uniform3fv(this.plain.tint, this.looks.rgb.trail);
    gl.drawArrays(gl.LINE_STRIP, first, end - first);
    gl.drawArrays(gl.POINTS, first, end - first);
  }
}

/** Return whether WebGL is computed without a graphics processor: then smooth edges cost too much. */
function isSoftware() {
  const gl = document.createElement("canvas").getContext("webgl2");
  const about = gl && gl.getExtension("WEBGL_debug_renderer_info");
  return /swiftshader|llvmpipe|software/i.test(about ? gl.getParameter(about.UNMASKED_RENDERER_WEBGL) : "");
}

/** Compute normals of vertices as the sum of the normals of their triangles by area. */
function normalsOf(p, faces) {
  const normals = new Float32Array(p.length);
  const at = (k) => [p[3 * k], p[3 * k + 1], p[3 * k + 2]];
  for (let i = 0; i < faces.length; i += 3) {
    const corners = [faces[i], faces[i + 1], faces[i + 2]];
    const [a, b, c] = corners.map(at);
    const n = cross(minus(b, a), minus(c, a));
    for (const corner of corners) for (let k = 0; k < 3; k++) normals[3 * corner + k] += n[k];
  }
  for (let i = 0; i < normals.length; i += 3) {
    const size = Math.hypot(normals[i], normals[i + 1], normals[i + 2]) || 1;
    for (let k = 0; k < 3; k++) normals[i + k] /= size;
  }
  return normals;
}

/** Return the triangles of an arrow of length 1 along x; a quarter is its head. */
function arrowTriangles({ radius_m: shaft, head_m: head }) {
  const p = [], faces = [], n = 12;
  for (const [[x0, r0], [x1, r1]] of [[[0, shaft], [0.75, shaft]], [[0.75, shaft], [0.75, head]], [[0.75, head], [1, 0]]]) {
    const base = p.length / 3;
    for (let i = 0; i <= n; i++) {
      const angle = (2 * Math.PI * i) / n, c = Math.cos(angle), s = Math.sin(angle);
      p.push(x0, r0 * c, r0 * s, x1, r1 * c, r1 * s);
      if (i < n) faces.push(...[0, 2, 1, 2, 3, 1].map((corner) => base + 2 * i + corner));
    }
  }
  return [p, new Array((p.length / 3) * 4).fill(0), faces];
}
