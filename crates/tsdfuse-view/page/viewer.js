// The viewer of tsdfuse: a surface in pieces, the path of the sensor, figures. The same for a page that was sent, which has
// all pieces in itself, and for a live one, which is told over a WebSocket what changed. Frame: metres, z up, relative to
// scene.origin (world).
"use strict";
const tsdfuse = (() => {
  const $ = (id) => document.getElementById(id);
  const waiting = []; // pieces of the page as they come, base64 of deflated bytes
  const api = { piece: (text) => waiting.push(text), start: () => { api.ready = begin(); return api.ready; }, errors: [] };

  // ---- bytes -------------------------------------------------------------------------------------------------------

  const fromBase64 = (text) => {
    if (Uint8Array.fromBase64) return Uint8Array.fromBase64(text);
    const binary = atob(text), bytes = new Uint8Array(binary.length);
    for (let i = 0; i < bytes.length; i++) bytes[i] = binary.charCodeAt(i);
    return bytes;
  };
  const inflate = async (bytes) => {
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
    return new Uint8Array(await new Response(stream).arrayBuffer());
  };

  // One packed piece (src/pack.rs describes the bytes) as arrays for the GPU; `at` is where it begins.
  const unpack = (bytes, channels, at = 0) => {
    const view = new DataView(bytes.buffer, bytes.byteOffset + at);
    const vertices = view.getUint32(0, true), triangles = view.getUint32(4, true), colored = view.getUint32(8, true);
    const origin = [view.getInt32(12, true), view.getInt32(16, true), view.getInt32(20, true)];
    let from = at + 24;
    const plane = (n) => bytes.subarray(from, (from += n));
    const position = new Uint16Array(4 * vertices);
    for (let axis = 0; axis < 3; axis++) {
      const low = plane(vertices), high = plane(vertices);
      let last = 0;
      for (let i = 0, to = axis; i < vertices; i++, to += 4) {
        const zigzag = low[i] | (high[i] << 8);
        last = (last + ((zigzag >> 1) ^ -(zigzag & 1))) & 65535;
        position[to] = last;
      }
    }
    // Normals on the octahedron, two bytes each (Cigolle et al. 2014).
    const u = plane(vertices), v = plane(vertices), normal = new Int8Array(4 * vertices);
    for (let i = 0, a = 0, b = 0; i < vertices; i++) {
      a = (a + u[i]) & 255; b = (b + v[i]) & 255;
      let x = a / 127 - 1, y = b / 127 - 1;
      const z = 1 - Math.abs(x) - Math.abs(y);
      if (z < 0) [x, y] = [(1 - Math.abs(y)) * (x < 0 ? -1 : 1), (1 - Math.abs(x)) * (y < 0 ? -1 : 1)];
      const scale = 127 / (Math.hypot(x, y, z) || 1);
      normal[4 * i] = Math.round(x * scale); normal[4 * i + 1] = Math.round(y * scale); normal[4 * i + 2] = Math.round(z * scale);
    }
    const bytesOf = (width, stride) => {
      const out = new Uint8Array(stride * vertices);
      for (let k = 0; k < width; k++) {
        const deltas = plane(vertices);
        for (let i = 0, last = 0; i < vertices; i++) out[stride * i + k] = last = (last + deltas[i]) & 255;
      }
      return out;
    };
    const color = colored ? bytesOf(3, 4) : null;
    const scalars = [];
    for (let k = 0; k < channels; k++) scalars.push(bytesOf(1, 1));
    const low = plane(3 * triangles), high = plane(3 * triangles), index = new Uint16Array(3 * triangles);
    for (let i = 0, next = 0; i < index.length; i++) {
      const back = low[i] | (high[i] << 8);
      index[i] = next - back;
      if (back === 0) next++;
    }
    return { origin, vertices, triangles, position, normal, color, scalars, index, end: from };
  };

  // ---- colours -----------------------------------------------------------------------------------------------------

  const SHADERS = {
    vertex: `
      in vec4 color; in float scalar;
      out vec3 place; out vec3 facing; out vec3 paint; out float value;
      void main() {
        vec4 at = modelMatrix * vec4(position, 1.0);
        place = at.xyz; facing = mat3(modelMatrix) * normal; paint = color.rgb; value = scalar;
        gl_Position = projectionMatrix * viewMatrix * at;
      }`,
    fragment: `
      precision highp float;
      in vec3 place; in vec3 facing; in vec3 paint; in float value;
      uniform int mode; uniform int ramp; uniform vec2 heights; uniform float clip;
      out vec4 shown;
      // Approximation of "turbo" (Mikhailov 2019) by polynomials.
      vec3 turbo(float t) {
        vec4 v4 = vec4(1.0, t, t * t, t * t * t); vec2 v2 = v4.zw * v4.z;
        return clamp(vec3(
          dot(v4, vec4(0.13572138, 4.61539260, -42.66032258, 132.13108234)) + dot(v2, vec2(-152.94239396, 59.28637943)),
          dot(v4, vec4(0.09140261, 2.19418839, 4.84296658, -14.18503333)) + dot(v2, vec2(4.27729857, 2.82956604)),
          dot(v4, vec4(0.10667330, 12.64194608, -60.58204836, 110.36276771)) + dot(v2, vec2(-89.90310912, 27.34824973))), 0.0, 1.0);
      }
      void main() {
        if (place.z > clip) discard;
        vec3 n = normalize(facing);
        vec3 eye = normalize(cameraPosition - place);
        // The side that was never seen is darker.
        float back = gl_FrontFacing ? 1.0 : 0.55;
        float lamp = abs(dot(n, eye)), sky = 0.5 + 0.5 * n.z;
        float light = (0.22 + 0.45 * lamp + 0.38 * sky) * back;
        vec3 base = vec3(0.80, 0.80, 0.78);
        if (mode == 1) base = turbo(clamp((place.z - heights.x) / (heights.y - heights.x), 0.0, 1.0));
        if (mode == 2) base = 0.5 + 0.5 * n;
        if (mode == 3) { base = paint; light = (0.9 + 0.2 * lamp) * back; }
        if (mode >= 4) { base = ramp == 0 ? vec3(value) : turbo(value); light = (0.5 + 0.5 * lamp) * back; }
        shown = vec4(base * min(light, 1.1), 1.0);
      }`,
    // Edges and hollows are darkened by how much nearer the neighbours are (eye-dome lighting, Boucheny 2009).
    screen: `out vec2 uvs; void main() { uvs = uv; gl_Position = vec4(position.xy, 0.0, 1.0); }`,
    dome: `
      precision highp float;
      uniform sampler2D image, depth; uniform vec2 pixel; uniform vec2 range; uniform vec2 edge; uniform mat4 turned; uniform bool sky;
      in vec2 uvs; out vec4 shown;
      // The colour of what lies behind all surface in a direction: a horizon, wherever the camera looks.
      vec3 behind(float up) {
        vec3 above = mix(vec3(0.91, 0.935, 0.955), vec3(0.63, 0.745, 0.86), smoothstep(0.0, 0.6, up));
        vec3 below = mix(vec3(0.76, 0.80, 0.84), vec3(0.55, 0.62, 0.70), smoothstep(0.0, 0.9, -up));
        return mix(below, above, smoothstep(-0.004, 0.004, up));
      }
      float far(vec2 at) {
        float d = texture(depth, at).x;
        if (d >= 1.0) return 40.0;
        return log2(range.x * range.y / (range.y - d * (range.y - range.x)));
      }
      void main() {
        vec4 seen = texture(image, uvs);
        float here = far(uvs), sum = 0.0;
        // Pixels that surface covers in part have the depth of what is behind it: they are no edge.
        for (int i = 0; i < 8 && here < 40.0; i++) {
          float a = 0.7853982 * float(i);
          float there = far(uvs + 1.4 * pixel * vec2(cos(a), sin(a)));
          sum += clamp(here - there, 0.0, 0.12);
        }
        seen.rgb *= exp(-2.2 * sum);
        vec3 way = mat3(turned) * vec3((2.0 * uvs - 1.0) * edge, -1.0);
        shown = sky ? vec4(seen.rgb + (1.0 - seen.a) * behind(way.z / length(way)), 1.0) : seen;
      }`,
  };
  const MODES = { shaded: 0, height: 1, normal: 2, colour: 3, scalar: 4 };

  // ---- the page ----------------------------------------------------------------------------------------------------

  async function begin() {
    const scene = JSON.parse($("scene").textContent);
    const library = document.createElement("script");
    library.textContent = new TextDecoder().decode(await inflate(fromBase64($("library").textContent.trim())));
    document.head.append(library);
    $("library").textContent = "";
    const T = THREE;
    const canvas = $("canvas");
    const renderer = new T.WebGLRenderer({ canvas, alpha: true, antialias: false, preserveDrawingBuffer: true });
    renderer.outputColorSpace = T.LinearSRGBColorSpace;
    renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    const world = new T.Scene(), over = new T.Scene();
    const camera = new T.PerspectiveCamera(60, 1, 0.1, 1e4);
    camera.up.set(0, 0, 1);
    const controls = new T.OrbitControls(camera, canvas);
    controls.zoomToCursor = true;
    controls.addEventListener("change", () => draw());

    // -- surface
    const uniforms = { mode: { value: 0 }, ramp: { value: 0 }, heights: { value: new T.Vector2(...scene.heights) }, clip: { value: 1e9 } };
    const material = new T.ShaderMaterial({ vertexShader: SHADERS.vertex, fragmentShader: SHADERS.fragment, uniforms, glslVersion: T.GLSL3, side: T.DoubleSide });
    const surface = new T.Group();
    world.add(surface);
    const channels = scene.channels || [];
    const bounds = new T.Box3();
    const counted = { vertices: 0, triangles: 0 };
    let channel = 0;
    const facing = []; // some vertices and where they face: which side is worth a look
    const geometryOf = (piece) => {
      const geometry = new T.BufferGeometry();
      geometry.setAttribute("position", new T.BufferAttribute(piece.position, 4));
      geometry.setAttribute("normal", new T.BufferAttribute(piece.normal, 4, true));
      if (piece.color) geometry.setAttribute("color", new T.BufferAttribute(piece.color, 4, true));
      geometry.scalars = piece.scalars;
      if (piece.scalars.length) geometry.setAttribute("scalar", new T.BufferAttribute(piece.scalars[Math.min(channel, piece.scalars.length - 1)], 1, true));
      geometry.setIndex(new T.BufferAttribute(piece.index, 1));
      return geometry;
    };
    const meshOf = (piece) => {
      const mesh = new T.Mesh(geometryOf(piece), material);
      mesh.scale.setScalar(scene.step);
      mesh.position.set(...piece.origin).multiplyScalar(scene.step);
      mesh.updateMatrixWorld(true);
      mesh.matrixAutoUpdate = false;
      mesh.geometry.computeBoundingSphere();
      surface.add(mesh);
      for (let i = 4 * (piece.vertices % 97); i < piece.position.length; i += 4 * 1021) {
        const [x, y, z] = [0, 1, 2].map((axis) => (piece.origin[axis] + piece.position[i + axis]) * scene.step);
        if (facing.length > 4000) facing.splice(0, 2000);
        facing.push({ place: new T.Vector3(x, y, z), normal: new T.Vector3(...piece.normal.subarray(i, i + 3)).divideScalar(127) });
      }
      return mesh;
    };

    let tilesShown = () => 0;

    // -- what is drawn over it: path, sweep, measured lines
    const lineOf = (color) => {
      const line = new T.Line(new T.BufferGeometry(), new T.LineBasicMaterial({ color }));
      line.frustumCulled = false;
      over.add(line);
      return line;
    };
    const setLine = (line, numbers) => {
      line.geometry.dispose();
      line.geometry = new T.BufferGeometry();
      line.geometry.setAttribute("position", new T.BufferAttribute(Float32Array.from(numbers), 3));
    };
    const pathLine = lineOf(0xd9480f), measured = lineOf(0x1d4ed8);
    const pathDots = new T.Points(new T.BufferGeometry(), new T.PointsMaterial({ color: 0xd9480f, size: 4, sizeAttenuation: false }));
    pathDots.frustumCulled = false;
    const sensorDot = new T.Points(new T.BufferGeometry(), new T.PointsMaterial({ color: 0xb91c1c, size: 11, sizeAttenuation: false }));
    sensorDot.frustumCulled = false;
    over.add(pathDots, sensorDot);
    let path = Array.from(scene.path || []);
    const showPath = () => {
      setLine(pathLine, path);
      setLine(pathDots, path);
      setLine(sensorDot, scene.live ? path.slice(-3) : []);
    };
    showPath();
    // Closed loops: a dot at both ends, and what lies between.
    const loopDots = new T.Points(new T.BufferGeometry(), new T.PointsMaterial({ color: 0x7c3aed, size: 8, sizeAttenuation: false }));
    loopDots.frustumCulled = false;
    over.add(loopDots);
    let loopLines = [];
    const setLoops = (ends) => {
      for (const line of loopLines) { over.remove(line); line.geometry.dispose(); }
      loopLines = [];
      setLine(loopDots, ends);
      for (let i = 0; i < ends.length; i += 6) {
        const line = lineOf(0x7c3aed);
        setLine(line, ends.slice(i, i + 6));
        loopLines.push(line);
      }
    };
    const sweep = new T.Points(new T.BufferGeometry(), new T.PointsMaterial({ color: 0x0f766e, size: 2, sizeAttenuation: false }));
    sweep.frustumCulled = false;
    over.add(sweep);

    // -- drawing, only when something changed
    const target = new T.WebGLRenderTarget(1, 1, { depthTexture: new T.DepthTexture(1, 1, T.FloatType), samples: 4 });
    const dome = new T.ShaderMaterial({
      vertexShader: SHADERS.screen, fragmentShader: SHADERS.dome, glslVersion: T.GLSL3, depthTest: false, depthWrite: false, transparent: true,
      blending: T.NoBlending,
      uniforms: { image: { value: target.texture }, depth: { value: target.depthTexture }, pixel: { value: new T.Vector2() }, range: { value: new T.Vector2() },
        edge: { value: new T.Vector2() }, turned: { value: camera.matrixWorld }, sky: { value: true } },
    });
    const quad = new T.Scene();
    const sheet = new T.Mesh(new T.PlaneGeometry(2, 2), dome);
    sheet.frustumCulled = false;
    quad.add(sheet);
    const flat = new T.OrthographicCamera(-1, 1, 1, -1, 0, 1);
    renderer.autoClear = false;
    let asked = false, frames = 0;
    const draw = () => { if (!asked) { asked = true; requestAnimationFrame(render); } };
    const resize = () => {
      const { clientWidth: w, clientHeight: h } = canvas;
      renderer.setSize(w, h, false);
      renderer.getDrawingBufferSize(dome.uniforms.pixel.value);
      target.setSize(dome.uniforms.pixel.value.x, dome.uniforms.pixel.value.y);
      dome.uniforms.pixel.value.set(1 / dome.uniforms.pixel.value.x, 1 / dome.uniforms.pixel.value.y);
      camera.aspect = w / h;
      camera.updateProjectionMatrix();
      draw();
    };
    function render() {
      asked = false;
      const away = flying ? 20 : camera.position.distanceTo(controls.target);
      camera.near = Math.max(0.02, away / 400);
      camera.far = camera.near * 2e4;
      camera.updateProjectionMatrix();
      dome.uniforms.range.value.set(camera.near, camera.far);
      const half = Math.tan((camera.fov * Math.PI) / 360);
      dome.uniforms.edge.value.set(half * camera.aspect, half);
      camera.updateMatrixWorld();
      renderer.setRenderTarget(target);
      renderer.setClearColor(0x000000, 0);
      renderer.clear();
      renderer.render(world, camera);
      renderer.render(over, camera);
      renderer.setRenderTarget(null);
      renderer.clear();
      renderer.render(quad, flat);
      placeLabels();
      frames++;
    }

    // -- places to look from
    let touched = false; // somebody looks from where they want
    for (const event of ["pointerdown", "wheel", "keydown"]) addEventListener(event, () => { touched = true; });
    const extent = () => {
      // Where the sensor drove, with some room; else all of the surface.
      const box = new T.Box3();
      for (let i = 0; i < path.length; i += 3) box.expandByPoint(new T.Vector3(path[i], path[i + 1], path[i + 2]));
      const low = scene.low, high = scene.high;
      if (low && high) {
        const whole = new T.Box3(new T.Vector3(...low), new T.Vector3(...high));
        if (box.isEmpty()) return whole;
        box.expandByScalar(15).intersect(whole);
        return box.isEmpty() ? whole : box;
      }
      if (box.isEmpty()) box.expandByPoint(new T.Vector3());
      return box.expandByScalar(25);
    };
    const look = (eye, at) => {
      camera.position.set(...eye);
      controls.target.set(...at);
      camera.lookAt(controls.target);
      controls.update();
      draw();
    };
    const towards = (turn) => new T.Vector3(Math.cos(turn) * 0.89, Math.sin(turn) * 0.89, 0.455);
    let side = null;
    const home = () => {
      const box = extent(), center = box.getCenter(new T.Vector3()), size = box.getSize(new T.Vector3());
      // Obliquely from above, from the side of the longest extent, unless more of the surface faces another one.
      side ??= size.x > size.y ? -Math.PI / 2 + 0.45 : 0.45;
      const faces = (turn) => {
        const way = towards(turn);
        let sum = 0;
        for (const { place, normal } of facing) if (box.containsPoint(place)) sum += Math.max(normal.dot(way), 0);
        return sum;
      };
      const turns = [0, 1, 2, 3, 4, 5, 6, 7].map((k) => side + (k * Math.PI) / 4);
      const best = turns.reduce((a, b) => (faces(b) > 1.1 * faces(a) ? b : a));
      side = best;
      look(towards(best).multiplyScalar(0.75 * Math.max(size.length(), 0.5)).add(center).toArray(), center.toArray());
    };
    const top = () => {
      const box = extent(), center = box.getCenter(new T.Vector3()), size = box.getSize(new T.Vector3());
      look([center.x, center.y - 1e-3, center.z + 1.1 * Math.max(size.x / camera.aspect, size.y, 0.5)], center.toArray());
    };

    // -- modes
    const names = ["shaded", "height", "normal"];
    if (scene.colored) names.push("colour");
    channels.forEach((c) => names.push(c.name));
    let mode = scene.colored ? "colour" : channels.some((c) => c.first) ? channels.find((c) => c.first).name : "shaded";
    const meters = (x) => `${x.toFixed(Math.abs(x) < 1 ? 3 : 2)} m`;
    const setMode = (name) => {
      if (!names.includes(name)) return;
      mode = name;
      const at = channels.findIndex((c) => c.name === name);
      uniforms.mode.value = at >= 0 ? MODES.scalar : MODES[name];
      if (at >= 0) {
        uniforms.ramp.value = channels[at].ramp === "grey" ? 0 : 1;
        channel = at;
        for (const mesh of surface.children) mesh.geometry.setAttribute("scalar", new T.BufferAttribute(mesh.geometry.scalars[at], 1, true));
      }
      for (const button of $("modes").children) button.setAttribute("aria-pressed", String(button.dataset.mode === name));
      showScale();
      draw();
    };
    const showScale = () => {
      const c = channels.find((c) => c.name === mode), isHeight = mode === "height";
      $("scale").hidden = !c && !isHeight;
      if ($("scale").hidden) return;
      const [low, high, unit] = c ? [c.low, c.high, c.unit] : [scene.heights[0] + scene.origin[2], scene.heights[1] + scene.origin[2], "m"];
      const text = (x) => `${+x.toPrecision(4)}${unit ? " " + unit : ""}`;
      $("low").textContent = text(low);
      $("high").textContent = text(high);
      $("ramp").style.background = c && c.ramp === "grey" ? "linear-gradient(90deg,#000,#fff)"
        : "linear-gradient(90deg,#30123b,#4669db,#26bce1,#3ff58a,#a4fc3c,#f1ca3a,#fb7e21,#c92903,#7a0403)";
    };
    const addMode = (name) => {
      if (!names.includes(name)) names.push(name);
      const button = document.createElement("button");
      button.dataset.mode = name;
      button.textContent = name[0].toUpperCase() + name.slice(1);
      button.title = `${button.textContent} (${names.indexOf(name) + 1})`;
      button.onclick = () => setMode(name);
      $("modes").append(button);
    };
    [...names].forEach(addMode);

    // -- clipping at a height
    const setClip = (share) => {
      $("clip").value = share;
      const [low, high] = [scene.low ? scene.low[2] : scene.heights[0] - 2, scene.high ? scene.high[2] : scene.heights[1] + 5];
      const off = share >= 1000;
      uniforms.clip.value = off ? 1e9 : low + ((high - low) * share) / 1000;
      $("clip-at").textContent = off ? "off" : meters(uniforms.clip.value + scene.origin[2]);
      draw();
    };
    $("clip").oninput = () => setClip(+$("clip").value);

    // -- pointing at the surface
    const raycaster = new T.Raycaster(), pickable = [surface];
    const pick = (x, y) => {
      const { left, top: up, width, height } = canvas.getBoundingClientRect();
      raycaster.setFromCamera(new T.Vector2((2 * (x - left)) / width - 1, 1 - (2 * (y - up)) / height), camera);
      return raycaster.intersectObjects(pickable, true).find((hit) => hit.point.z <= uniforms.clip.value);
    };
    let measuring = false, ends = [];
    const labels = []; // { at: Vector3, element }
    const label = (at, text) => {
      const element = document.createElement("span");
      element.textContent = text;
      $("labels").append(element);
      labels.push({ at, element });
      return element;
    };
    const placeLabels = () => {
      for (const { at, element } of labels) {
        const on = at.clone().project(camera);
        element.hidden = on.z > 1;
        element.style.left = `${(on.x * 0.5 + 0.5) * canvas.clientWidth}px`;
        element.style.top = `${(0.5 - on.y * 0.5) * canvas.clientHeight}px`;
      }
    };
    const forget = () => {
      ends = [];
      setLine(measured, []);
      labels.splice(0).forEach(({ element }) => element.remove());
    };
    const measureAt = (x, y) => {
      const hit = pick(x, y);
      if (!hit) return;
      if (ends.length === 2) forget();
      ends.push(hit.point);
      const [a, b] = ends;
      if (!b) {
        const p = a.clone().add(new T.Vector3(...scene.origin));
        label(a, `${p.x.toFixed(2)}, ${p.y.toFixed(2)}, ${p.z.toFixed(2)}`);
      } else {
        labels.splice(0).forEach(({ element }) => element.remove());
        const d = b.clone().sub(a);
        label(a.clone().add(b).multiplyScalar(0.5), `${meters(d.length())}\nlevel ${meters(Math.hypot(d.x, d.y))}, height ${meters(d.z)}`);
        setLine(measured, [...a.toArray(), ...b.toArray()]);
      }
      draw();
    };
    // The value under the pointer.
    let hovered = 0;
    const tell = $("status");
    const hover = (x, y) => {
      const at = channels.findIndex((c) => c.name === mode);
      if (at < 0 || performance.now() - hovered < 60) return;
      hovered = performance.now();
      const hit = pick(x, y);
      if (!hit) { tell.textContent = ""; return; }
      const scalar = hit.object.geometry.scalars[at];
      const { a, b, c } = hit.face;
      const share = (scalar[a] + scalar[b] + scalar[c]) / 765, { low, high, unit, name } = channels[at];
      tell.textContent = `${name} ${+(low + (high - low) * share).toPrecision(3)} ${unit}`;
    };

    // -- flying
    let flying = false;
    const held = new Set();
    const setFlying = (on) => {
      flying = on;
      controls.enabled = !on;
      $("fly").setAttribute("aria-pressed", String(on));
      if (!on) {
        const ahead = camera.getWorldDirection(new T.Vector3());
        controls.target.copy(camera.position).addScaledVector(ahead, 15);
        controls.update();
      }
      draw();
    };
    const turn = (right, down) => {
      const ahead = camera.getWorldDirection(new T.Vector3());
      const yaw = Math.atan2(ahead.y, ahead.x) - right;
      const pitch = Math.max(-1.5, Math.min(1.5, Math.asin(ahead.z) - down));
      const to = new T.Vector3(Math.cos(yaw) * Math.cos(pitch), Math.sin(yaw) * Math.cos(pitch), Math.sin(pitch));
      camera.lookAt(to.add(camera.position));
      draw();
    };
    const forward = (ahead, right, up) => {
      const to = camera.getWorldDirection(new T.Vector3());
      const side = to.clone().cross(camera.up).normalize();
      const move = to.multiplyScalar(ahead).addScaledVector(side, right).addScaledVector(camera.up, up);
      camera.position.add(move);
      if (!flying) controls.target.add(move);
      draw();
    };
    const KEYS = { KeyW: [1, 0, 0], KeyS: [-1, 0, 0], KeyA: [0, -1, 0], KeyD: [0, 1, 0], KeyQ: [0, 0, -1], KeyE: [0, 0, 1] };
    const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    let last = 0;
    const step = (now) => {
      if (!held.size) { last = 0; return; }
      const secs = last ? Math.min(0.1, (now - last) / 1000) : 0.016;
      last = now;
      const reach = flying ? 8 : 0.6 * camera.position.distanceTo(controls.target);
      const speed = (held.has("ShiftLeft") || held.has("ShiftRight") ? 5 : 1) * secs;
      for (const key of held) {
        if (KEYS[key]) forward(...KEYS[key].map((x) => x * speed * reach));
        if (ARROWS[key] && flying) turn(...ARROWS[key].map((x) => x * speed));
        if (ARROWS[key] && !flying) orbit(...ARROWS[key].map((x) => x * speed));
      }
      requestAnimationFrame(step);
    };
    const orbit = (right, down) => {
      const arm = camera.position.clone().sub(controls.target), length = arm.length();
      const yaw = Math.atan2(arm.y, arm.x) + right;
      const pitch = Math.max(-1.5, Math.min(1.5, Math.asin(arm.z / length) + down));
      arm.set(Math.cos(yaw) * Math.cos(pitch), Math.sin(yaw) * Math.cos(pitch), Math.sin(pitch)).multiplyScalar(length);
      camera.position.copy(controls.target).add(arm);
      controls.update();
      draw();
    };
    let press = null;
    const fingers = new Map();
    canvas.addEventListener("pointerdown", (e) => {
      canvas.focus({ preventScroll: true });
      press = { x: e.clientX, y: e.clientY };
      fingers.set(e.pointerId, { x: e.clientX, y: e.clientY });
      if (flying) canvas.setPointerCapture(e.pointerId);
    });
    canvas.addEventListener("pointermove", (e) => {
      const before = fingers.get(e.pointerId);
      if (before && flying) {
        const [dx, dy] = [e.clientX - before.x, e.clientY - before.y];
        // One finger or the mouse looks around, two fingers move.
        if (fingers.size > 1) forward(-dy * 0.02, -dx * 0.02, 0);
        else turn(-dx * 0.004, -dy * 0.004);
      }
      if (before) fingers.set(e.pointerId, { x: e.clientX, y: e.clientY });
      else hover(e.clientX, e.clientY);
    });
    const release = (e) => {
      fingers.delete(e.pointerId);
      const still = press && Math.hypot(e.clientX - press.x, e.clientY - press.y) < 6;
      if (measuring && still && e.type === "pointerup") measureAt(e.clientX, e.clientY);
      press = null;
    };
    canvas.addEventListener("pointerup", release);
    canvas.addEventListener("pointercancel", release);
    canvas.addEventListener("wheel", (e) => { if (flying) { e.preventDefault(); forward(-e.deltaY * 0.02, 0, 0); } }, { passive: false });
    canvas.addEventListener("dblclick", (e) => {
      const hit = pick(e.clientX, e.clientY);
      if (hit && !flying && !measuring) { controls.target.copy(hit.point); controls.update(); draw(); }
    });

    // -- buttons and keys
    const toggle = (button, set) => () => { const on = button.getAttribute("aria-pressed") !== "true"; button.setAttribute("aria-pressed", String(on)); set(on); draw(); };
    const actions = {
      KeyF: () => setFlying(!flying),
      KeyM: toggle($("measure"), (on) => { measuring = on; forget(); tell.textContent = on ? "Click two points" : ""; }),
      KeyP: toggle($("path"), (on) => { for (const shown of [pathLine, pathDots, loopDots, ...loopLines]) shown.visible = on; }),
      KeyL: toggle($("sweep"), (on) => { sweep.visible = on; }),
      KeyT: () => { setFlying(false); top(); },
      KeyH: () => { setFlying(false); home(); },
      BracketLeft: () => setClip(Math.max(0, +$("clip").value - 25)),
      BracketRight: () => setClip(Math.min(1000, +$("clip").value + 25)),
      Escape: () => { if (flying) setFlying(false); forget(); draw(); },
    };
    for (const [id, key] of [["fly", "KeyF"], ["measure", "KeyM"], ["path", "KeyP"], ["sweep", "KeyL"], ["top", "KeyT"], ["home", "KeyH"]]) $(id).onclick = actions[key];
    addEventListener("keydown", (e) => {
      if (e.ctrlKey || e.metaKey || e.altKey || e.target === $("clip")) return;
      if (actions[e.code]) { if (!e.repeat || e.code.startsWith("Bracket")) actions[e.code](); return; }
      if (/^Digit[1-9]$/.test(e.code)) { setMode(names[+e.code[5] - 1]); return; }
      if (KEYS[e.code] || ARROWS[e.code] || e.code.startsWith("Shift")) {
        e.preventDefault();
        const idle = !held.size;
        held.add(e.code);
        if (idle) requestAnimationFrame(step);
      }
    });
    addEventListener("keyup", (e) => held.delete(e.code));
    addEventListener("blur", () => held.clear());
    addEventListener("resize", resize);

    // -- figures
    const setFigures = (rows) => {
      $("table").replaceChildren(...rows.map(([name, value]) => {
        const row = document.createElement("tr");
        for (const text of [name, value]) row.insertCell().textContent = text;
        return row;
      }));
    };
    document.title = $("title").textContent = scene.title;
    setFigures(scene.figures || []);
    api.unpack = unpack;
    Object.assign(api, {
      look, setMode, setClip, measureAt,
      hideSky: () => { dome.uniforms.sky.value = false; draw(); },
      state: () => ({
        mode, flying, measuring, frames, ...counted, tiles: tilesShown(), meshes: surface.children.length, clip: uniforms.clip.value,
        eye: camera.position.toArray(), at: controls.target.toArray(), path: path.length / 3, loops: loopLines.length, ahead: camera.getWorldDirection(new T.Vector3()).toArray(),
        labels: labels.map(({ element }) => element.textContent), figures: [...$("table").rows].map((row) => row.textContent), status: tell.textContent,
      }),
    });
    resize();
    home();
    setMode(mode);
    renderer.compile(world, camera);
    if (scene.live) {
      if (scene.tiles) await showTiles();
      else live();
      return;
    }
    for (const [i, text] of waiting.entries()) {
      const piece = unpack(await inflate(fromBase64(text)), channels.length);
      waiting[i] = "";
      counted.vertices += piece.vertices;
      counted.triangles += piece.triangles;
      meshOf(piece);
      if (i % 8 === 0) { tell.textContent = `${Math.round((100 * i) / waiting.length)} %`; draw(); await new Promise((go) => setTimeout(go)); }
    }
    tell.textContent = "";
    if (!touched) home();
    render();

    // -- live: what changed comes over a WebSocket, and the next only when this is shown
    function live() {
      const shown = new Map(); // by the name of a region, or of a piece that is for itself
      const changed = new Set();
      let seconds = [], sampled = [], answer = null;
      const regionOf = (x, y, z) => (scene.blocks ? `${x >> 3},${y >> 3},${z >> 3}` : `${x},${y},${z}`);
      // The pieces of a region as one, which is drawn quickly.
      const join = (pieces) => {
        const all = [...pieces.values()];
        if (all.length === 1) return all[0];
        const origin = [0, 1, 2].map((axis) => Math.min(...all.map((piece) => piece.origin[axis])));
        const vertices = all.reduce((sum, piece) => sum + piece.vertices, 0), triangles = all.reduce((sum, piece) => sum + piece.triangles, 0);
        const whole = { origin, vertices, triangles, position: new Uint16Array(4 * vertices), normal: new Int8Array(4 * vertices), color: null, scalars: [],
          index: new (vertices > 65536 ? Uint32Array : Uint16Array)(3 * triangles) };
        let v = 0, t = 0;
        for (const piece of all) {
          const [dx, dy, dz] = [0, 1, 2].map((axis) => piece.origin[axis] - origin[axis]);
          for (let i = 0; i < 4 * piece.vertices; i += 4) {
            whole.position[4 * v + i] = piece.position[i] + dx;
            whole.position[4 * v + i + 1] = piece.position[i + 1] + dy;
            whole.position[4 * v + i + 2] = piece.position[i + 2] + dz;
          }
          whole.normal.set(piece.normal, 4 * v);
          for (let i = 0; i < piece.index.length; i++) whole.index[t + i] = piece.index[i] + v;
          v += piece.vertices;
          t += piece.index.length;
        }
        return whole;
      };
      const rebuild = (name) => {
        const region = shown.get(name);
        if (region.mesh) {
          surface.remove(region.mesh);
          region.mesh.geometry.dispose();
          counted.vertices -= region.counted[0];
          counted.triangles -= region.counted[1];
          region.mesh = null;
        }
        if (!region.pieces.size) { shown.delete(name); return; }
        const whole = join(region.pieces);
        region.mesh = meshOf(whole);
        region.counted = [whole.vertices, whole.triangles];
        counted.vertices += whole.vertices;
        counted.triangles += whole.triangles;
        // Some heights of what came, for colours and for cutting.
        for (let i = 2; i < whole.position.length; i += 1024) sampled.push((whole.position[i] + whole.origin[2]) * scene.step);
        if (sampled.length > 50000) sampled = sampled.filter((_, i) => i % 2);
      };
      const spread = () => {
        if (scene.blocks && sampled.length > 20) {
          const sorted = Float64Array.from(sampled).sort();
          const at = (share) => sorted[Math.floor(share * (sorted.length - 1))];
          scene.heights = [at(0.02), Math.max(at(0.98), at(0.02) + 1e-3)];
          const box = new T.Box3();
          for (const mesh of surface.children) { const { center, radius } = mesh.geometry.boundingSphere; box.expandByPoint(center.clone().multiplyScalar(scene.step).add(mesh.position).addScalar(radius * scene.step)); box.expandByPoint(center.clone().multiplyScalar(scene.step).add(mesh.position).addScalar(-radius * scene.step)); }
          [scene.low, scene.high] = [box.min.toArray(), box.max.toArray()];
        }
        uniforms.heights.value.set(...scene.heights);
        showScale();
      };
      // Where drawing is slow, for want of a GPU, each frame takes in more, for a third of its time.
      let lastWork = 0, frame = 0;
      const work = () => {
        const now = performance.now();
        frame = Math.min(now - lastWork, 1500);
        lastWork = now;
        const until = now + Math.max(8, frame / 3);
        for (const name of changed) {
          changed.delete(name);
          rebuild(name);
          if (performance.now() > until) break;
        }
        draw();
        if (changed.size) { requestAnimationFrame(work); return; }
        spread();
        if (!touched) home();
        // Frames of a tenth of a second want twice as much, and so on.
        if (answer) { answer(`ok ${Math.max(1, Math.round(frame / 50))}`); answer = null; }
      };
      const plot = () => {
        const sheet = $("plot"), pen = sheet.getContext("2d"), last = seconds.slice(-sheet.width);
        sheet.hidden = last.length < 2;
        sheet.title = "Milliseconds a scan";
        if (sheet.hidden) return;
        const most = Math.max(...last);
        pen.clearRect(0, 0, sheet.width, sheet.height);
        pen.fillStyle = "#2f6db3";
        last.forEach((s, i) => { const h = (sheet.height * s) / most; pen.fillRect(i, sheet.height - h, 1, h); });
        pen.fillStyle = "#1d2733";
        pen.fillText(`${(1000 * most).toFixed(0)} ms a scan`, 4, 10);
      };
      const take = (buffer) => {
        const bytes = new Uint8Array(buffer), length = new DataView(buffer).getUint32(0, true);
        const news = JSON.parse(new TextDecoder().decode(bytes.subarray(4, 4 + length)));
        if (news.scene) {
          const { heights, ...rest } = news.scene;
          Object.assign(scene, rest, heights ? { heights } : {});
          document.title = $("title").textContent = scene.title;
          if (scene.channels.length && !channels.length) { channels.push(...scene.channels); scene.channels.forEach((c) => addMode(c.name)); }
          if (scene.colored && !names.includes("colour")) { addMode("colour"); setMode("colour"); }
          $("sweep").hidden = !scene.blocks;
          tell.textContent = scene.ended ? "" : "live";
        }
        let at = 4 + length;
        for (const [x, y, z, size] of news.pieces) {
          const name = regionOf(x, y, z), piece = `${x},${y},${z}`;
          if (!shown.has(name)) shown.set(name, { pieces: new Map(), mesh: null });
          const { pieces } = shown.get(name);
          if (size) pieces.set(piece, unpack(bytes, channels.length, at));
          else pieces.delete(piece);
          at += size;
          changed.add(name);
        }
        if (news.path.length || news.path_from * 3 !== path.length) {
          path.length = 3 * news.path_from;
          for (const x of news.path) path.push(x);
          showPath();
        }
        if (news.loops) setLoops(news.loops);
        if (news.seconds.length) { seconds.push(...news.seconds); plot(); }
        if (news.figures) setFigures(news.figures);
        if (news.sweep !== null) setLine(sweep, new Float32Array(buffer.slice(at, at + news.sweep)));
        if (scene.ended) setLine(sweep, []);
        lastWork = performance.now();
        requestAnimationFrame(work);
      };
      const connect = () => {
        const socket = new WebSocket(new URL("live", location.href.replace(/^http/, "ws")));
        socket.binaryType = "arraybuffer";
        socket.onopen = () => { seconds = []; };
        socket.onmessage = ({ data }) => {
          if (typeof data === "string") { socket.send("ok"); return; }
          answer = (text) => { if (socket.readyState === 1) socket.send(text); };
          take(data);
        };
        socket.onclose = () => {
          if (!scene.ended) tell.textContent = "The program has ended or cannot be reached";
          setTimeout(connect, 2000);
        };
      };
      connect();
    }

    // -- tiles: what is in view, as fine as the screen shows it
    async function showTiles() {
      const tiles = new T.TilesRenderer(new URL(scene.tiles, location.href).href);
      tiles.setCamera(camera);
      tiles.errorTarget = 4;
      world.add(tiles.group);
      tiles.addEventListener("load-model", ({ scene: model }) => {
        model.traverse((mesh) => {
          if (!mesh.isMesh) return;
          mesh.material = material;
          if (mesh.geometry.attributes.color && !names.includes("colour")) { addMode("colour"); setMode("colour"); }
        });
        draw();
      });
      let loaded = false;
      tilesShown = () => tiles.visibleTiles.size;
      tiles.addEventListener("load-root-tileset", () => {
        // Whole metres near the tiles are the origin, so that numbers stay small.
        const sphere = new T.Sphere();
        tiles.getBoundingSphere(sphere);
        scene.origin = sphere.center.clone().round().toArray();
        tiles.group.position.fromArray(scene.origin).negate();
        tiles.group.updateMatrixWorld(true);
        const center = sphere.center.clone().sub(new T.Vector3(...scene.origin));
        const box = new T.Box3(), size = new T.Vector3(), turned = new T.Matrix4();
        if (tiles.getOrientedBoundingBox(box, turned)) box.getSize(size);
        else size.setScalar(2 * sphere.radius);
        [scene.low, scene.high] = [center.clone().addScaledVector(size, -0.5).toArray(), center.clone().addScaledVector(size, 0.5).toArray()];
        scene.heights = [scene.low[2], scene.high[2]];
        uniforms.heights.value.set(...scene.heights);
        home();
        loaded = true;
      });
      const keep = () => {
        camera.updateMatrixWorld();
        tiles.setResolutionFromRenderer(camera, renderer);
        tiles.update();
        requestAnimationFrame(keep);
      };
      keep();
      tiles.addEventListener("tiles-load-end", () => { if (loaded) draw(); });
      pickable.push(tiles.group);
    }
  }
  addEventListener("error", (e) => api.errors.push(e.message));
  addEventListener("unhandledrejection", (e) => api.errors.push(String(e.reason)));
  return api;
})();
