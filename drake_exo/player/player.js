// Plays clips in a meshcat viewer: bodies move, arrows stretch, surfaces
// deform and change colour. `viewer` and `PLAYER` are globals of the page.
(() => {
  "use strict";
  const page = PLAYER;
  const $ = (id) => document.getElementById(id);
  const send = (command) => viewer.handle_command(command);
  const place = (path, matrix) =>
    send({ type: "set_transform", path, matrix });
  const show = (path, value) =>
    send({ type: "set_property", path, property: "visible", value });

  // --- Numbers -----------------------------------------------------------
  const types = { f4: Float32Array, u2: Uint16Array, u4: Uint32Array };
  const unpack = (packed) => {
    const bytes = Uint8Array.from(atob(packed.data), (c) => c.charCodeAt(0));
    return new types[packed.type](bytes.buffer);
  };
  const lerp = (a, b, s) => a + (b - a) * s;
  // Row (width) of an array of rows, between rows k and k + 1.
  const row = (array, width, k, s) => {
    const i = k * width, j = s > 0 ? i + width : i;
    return Array.from({ length: width }, (_, c) =>
      lerp(array[i + c], array[j + c], s));
  };
  const moved = (x, y, z) => [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, x, y, z, 1];
  // Column-major matrix of a pose: position, quaternion (w, x, y, z).
  const poseMatrix = ([x, y, z, w, a, b, c]) => {
    const n = 1 / Math.hypot(w, a, b, c);
    w *= n; a *= n; b *= n; c *= n;
    return [
      1 - 2 * (b * b + c * c), 2 * (a * b + w * c), 2 * (a * c - w * b), 0,
      2 * (a * b - w * c), 1 - 2 * (a * a + c * c), 2 * (b * c + w * a), 0,
      2 * (a * c + w * b), 2 * (b * c - w * a), 1 - 2 * (a * a + b * b), 0,
      x, y, z, 1,
    ];
  };
  // Frame at p whose z axis points along d.
  const alongMatrix = (p, d) => {
    const n = Math.hypot(...d), z = d.map((v) => v / n);
    const up = Math.abs(z[1]) < 0.9 ? [0, 1, 0] : [1, 0, 0];
    const cross = (u, v) => [
      u[1] * v[2] - u[2] * v[1],
      u[2] * v[0] - u[0] * v[2],
      u[0] * v[1] - u[1] * v[0],
    ];
    let x = cross(up, z);
    const m = Math.hypot(...x);
    x = x.map((v) => v / m);
    const y = cross(z, x);
    return [...x, 0, ...y, 0, ...z, 0, ...p, 1];
  };

  // --- Things that move --------------------------------------------------
  const mesh = (uuid, geometry, material, matrix) => ({
    metadata: { version: 4.5, type: "Object" },
    geometries: [{ uuid: uuid + "-geometry", ...geometry }],
    materials: [{ uuid: uuid + "-material", ...material }],
    object: {
      uuid, type: "Mesh", geometry: uuid + "-geometry",
      material: uuid + "-material", matrix, renderOrder: 10,
    },
  });
  // Cylinders of three.js lie along y; ours along z, from 0 to the height.
  const standing = (height) =>
    [1, 0, 0, 0, 0, 0, 1, 0, 0, -1, 0, 0, 0, 0, height / 2, 1];
  const arrowPath = (arrow) => `${arrow.root}/${arrow.name}`;
  const makeArrow = (arrow) => {
    const path = arrowPath(arrow), r = arrow.radius_m;
    // Drawn over everything: a force within the body must be seen.
    const material = {
      type: "MeshBasicMaterial", color: parseInt(arrow.colour.slice(1), 16),
      depthTest: false, transparent: true, opacity: arrow.opacity,
    };
    const part = (name, top, bottom, height) => send({
      type: "set_object", path: `${path}/${name}`,
      object: mesh(`${arrow.name}-${name}`, {
        type: "CylinderGeometry", radiusTop: top, radiusBottom: bottom,
        height, radialSegments: 20,
      }, material, standing(height)),
    });
    part("shaft", r, r, 1);
    part("head", 0, 2.4 * r, 5.5 * r);
    const label = document.createElement("div");
    label.className = "player-label";
    label.style.color = arrow.colour;
    if (arrow.label) document.body.appendChild(label);
    arrow.element = label;
  };
  const drawArrow = (arrow, values) => {
    const path = arrowPath(arrow);
    const p = values && values.slice(0, 3), f = values && values.slice(3);
    const size = values ? Math.hypot(...f) : NaN;
    arrow.size = size;
    arrow.tip = null;
    const seen = size >= 1;  // N; weaker forces are not drawn
    show(path, seen);
    if (!seen) return;
    const length = size * arrow.metres_per_newton;
    const head = Math.min(5.5 * arrow.radius_m, 0.6 * length);
    const shaft = length - head, scale = head / (5.5 * arrow.radius_m);
    place(path, alongMatrix(p, f));
    place(`${path}/shaft`,
      [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, shaft, 0, 0, 0, 0, 1]);
    place(`${path}/head`,
      [scale, 0, 0, 0, 0, scale, 0, 0, 0, 0, scale, 0, 0, 0, shaft, 1]);
    const far = (length + 0.02) / size;
    arrow.tip = p.map((v, i) => v + f[i] * far);
  };
  // Colour map as a table of 256 colours.
  const colours = page.colours ? unpack(page.colours) : null;
  const makeSurface = (path, surface) => {
    const attribute = (array, type) => ({ itemSize: 3, type, array });
    const n = surface.rest.length;
    send({
      type: "set_object", path,
      object: mesh(`surface-${path}`, {
        type: "BufferGeometry",
        data: {
          attributes: {
            position: attribute(Array.from(surface.rest), "Float32Array"),
            color: attribute(new Array(n).fill(0.6), "Float32Array"),
          },
          index: { itemSize: 1, type: "Uint32Array",
            array: Array.from(surface.faces) },
        },
      }, { type: "MeshLambertMaterial", vertexColors: true, side: 2,
        flatShading: true, color: 0xffffff }, moved(0, 0, 0)),
    });
    const parts = path.split("/").filter((p) => p);
    const object = viewer.scene_tree.find([...parts, "<object>"]).object;
    object.frustumCulled = false;
    object.renderOrder = 0;
    object.material.vertexColors = true;
    object.material.needsUpdate = true;
    surface.object = object;
    for (const [copy, matrix] of Object.entries(surface.copies)) {
      viewer.set_object(copy.split("/").filter((p) => p), object.clone());
      place(copy, matrix);
    }
  };
  const drawSurface = (surface, k, s) => {
    const n = surface.rest.length, { low, span } = surface;
    const position = surface.object.geometry.attributes.position;
    const colour = surface.object.geometry.attributes.color;
    const i = k * n, j = s > 0 ? i + n : i;
    for (let c = 0; c < n; c++) {
      const q = lerp(surface.places[i + c], surface.places[j + c], s);
      position.array[c] = low[c % 3] + q * span[c % 3] / 65535;
    }
    const m = n / 3, u = k * m, v = s > 0 ? u + m : u;
    for (let a = 0; a < m; a++) {
      const value = lerp(surface.values[u + a], surface.values[v + a], s);
      const at = 3 * Math.round(value * 255 / 65535);
      for (let c = 0; c < 3; c++)
        colour.array[3 * a + c] = value > 0 ? colours[at + c] : 0.62;
    }
    position.needsUpdate = colour.needsUpdate = true;
  };

  // --- Clips -------------------------------------------------------------
  const state = { clip: null, time: 0, playing: true, speed: 1, rest: 0 };
  const openClip = (number) => {
    const clip = page.clips[number];
    if (!clip.ready) {
      clip.times = unpack(clip.times);
      for (const kind of ["bodies", "arrows"])
        for (const name in clip[kind])
          clip[kind][name] = unpack(clip[kind][name]);
      for (const surface of Object.values(clip.surfaces))
        for (const name of ["rest", "faces", "places", "values"])
          surface[name] = unpack(surface[name]);
      clip.ready = true;
    }
    for (const other of page.clips)
      for (const [path, surface] of Object.entries(other.surfaces)) {
        if (other === clip && !surface.object) makeSurface(path, surface);
        if (surface.object)
          for (const shown of [path, ...Object.keys(surface.copies)])
            show(shown, other === clip);
      }
    state.clip = clip;
    const end = clip.times[clip.times.length - 1];
    state.time = Math.min(state.time, end); // to compare the same instant
    $("player-slider").max = end;
    $("player-slider").step = end / 1000;
    $("player-note").textContent = clip.note;
    $("player-mark").textContent = clip.mark;
    draw();
  };
  const draw = () => {
    const { clip, time } = state, times = clip.times;
    let k = 0, high = times.length - 1;
    while (high - k > 1) {
      const middle = (k + high) >> 1;
      if (times[middle] <= time) k = middle; else high = middle;
    }
    const s = Math.min(1, Math.max(0,
      (time - times[k]) / (times[k + 1] - times[k])));
    for (const path of page.bodies) {
      const found = clip.bodies[path];
      const pose = found && row(found, 7, k, s);
      const there = pose !== undefined && !pose.some(Number.isNaN);
      show(path, there);
      if (there) place(path, poseMatrix(pose));
    }
    for (const arrow of page.arrows) {
      const found = clip.arrows[arrow.name];
      const values = found && row(found, 6, k, s);
      drawArrow(arrow,
        values && !values.some(Number.isNaN) ? values : null);
      const cell = $(`player-value-${arrow.name}`);
      if (cell) cell.textContent =
        Number.isNaN(arrow.size) ? "–" : `${arrow.size.toFixed(0)} N`;
    }
    for (const surface of Object.values(clip.surfaces))
      drawSurface(surface, k, s);
    $("player-slider").value = time;
    $("player-time").textContent =
      `${time.toFixed(2)} / ${times[times.length - 1].toFixed(2)} s`;
    viewer.set_dirty();
  };

  // --- Labels at the tips of arrows ---------------------------------------
  const product = (m, v) => [0, 1, 2, 3].map((i) =>
    m[i] * v[0] + m[4 + i] * v[1] + m[8 + i] * v[2] + m[12 + i] * v[3]);
  const label = (arrow, placed) => {
    const element = arrow.element;
    const on = arrow.tip && arrow.label && !hidden.has(arrow.root);
    element.style.display = on ? "block" : "none";
    if (!on) return;
    const shift = shifts[arrow.root] || [0, 0, 0];
    const [x, y, z] = arrow.tip.map((v, i) => v + shift[i]);
    const camera = viewer.camera;
    camera.updateMatrixWorld();
    const seen = product(camera.projectionMatrix.elements, product(
      camera.matrixWorldInverse.elements, [x, z, -y, 1]));
    const [width, height] = [window.innerWidth, window.innerHeight];
    element.textContent = `${arrow.label} ${arrow.size.toFixed(0)} N`;
    const left = (seen[0] / seen[3] + 1) / 2 * width + 5;
    const right = left + element.offsetWidth;
    let top = (1 - seen[1] / seen[3]) / 2 * height - 16;
    // Above those that it would lie on.
    while (placed.some(([x, end, y]) =>
      left < end && x < right && Math.abs(y - top) < 16)) top -= 4;
    placed.push([left, right, top]);
    element.style.left = `${left}px`;
    element.style.top = `${top}px`;
  };

  // --- Controls ----------------------------------------------------------
  const hidden = new Set(), shifts = {};
  const look = (eye, target) => {
    const rotated = ([x, y, z]) => [x, z, -y];
    send({ type: "set_property", path: "/Cameras/default/rotated/<object>",
      property: "position", value: rotated(eye) });
    viewer.camera.fov = page.camera.fov;
    viewer.camera.updateProjectionMatrix();
    viewer.controls.target.set(...rotated(target));
    viewer.controls.update();
  };
  const ghost = (mode) => {
    const { root, beside } = page.ghost;
    const shift = mode === "beside" ? beside : [0, 0, 0];
    shifts[root] = shifts[`${root}/arrows`] = shift;
    place(root, moved(...shift));
    const { eye, target } = page.camera, back = mode === "beside" ? 1.35 : 1;
    const middle = target.map((v, i) => v + shift[i] / 2);
    look(eye.map((v, i) => middle[i] + back * (v - target[i])), middle);
  };
  const toggle = (path, on) => {
    if (on) hidden.delete(path); else hidden.add(path);
    show(path, on);
  };
  // A box shows nothing of a ghost that is hidden, nor the ghost what is off.
  const reveal = () => {
    const root = page.ghost && page.ghost.root;
    const gone = root && $("player-ghost").value === "hidden";
    if (root)
      for (const path of [root, `${root}/arrows`]) toggle(path, !gone);
    page.switches.forEach(({ paths }, i) => {
      const on = $(`player-switch-${i}`).checked;
      for (const path of paths)
        toggle(path, on && !(gone && path.startsWith(`${root}/`)));
    });
  };
  const play = (on) => {
    state.playing = on;
    $("player-play").textContent = on ? "pause" : "play";
  };
  const connect = () => {
    $("player-clip").onchange = (e) => openClip(Number(e.target.value));
    $("player-play").onclick = () => play(!state.playing);
    $("player-speed").onchange = (e) => {
      state.speed = Number(e.target.value);
    };
    $("player-slider").oninput = (e) => {
      play(false);
      state.time = Number(e.target.value);
      draw();
    };
    if (page.ghost)
      $("player-ghost").onchange = (e) => {
        ghost(e.target.value);
        reveal();
      };
    page.switches.forEach((_, i) => {
      $(`player-switch-${i}`).onchange = reveal;
    });
    document.addEventListener("keydown", (e) => {
      if (e.target.tagName === "SELECT") return;
      const step = { ArrowLeft: -0.02, ArrowRight: 0.02 }[e.key];
      // Of buttons and boxes space is their own.
      if (e.key === " " && !e.target.matches("button, [type=checkbox]"))
        play(!state.playing);
      else if (step) {
        play(false);
        const end = Number($("player-slider").max);
        state.time = Math.min(end, Math.max(0, state.time + step));
        draw();
      } else return;
      e.preventDefault();
    });
  };
  // Where both coincide the ghost stays behind, without flicker. Its meshes
  // load in their own time, so this is done for some seconds.
  const recede = () => {
    const root = page.ghost.root.split("/").filter((part) => part);
    viewer.scene_tree.find(root).object.traverse((object) => {
      const material = object.material;
      if (!material || material.polygonOffset || !material.depthTest) return;
      Object.assign(material, { polygonOffset: true, polygonOffsetFactor: 4,
        polygonOffsetUnits: 40, depthWrite: false, needsUpdate: true });
      object.castShadow = false;
      viewer.set_dirty();
    });
  };
  // The page's own commands may come later than this script: they lose.
  let stale = true;
  const receive = viewer.handle_command_bytearray.bind(viewer);
  viewer.handle_command_bytearray = (bytes) => {
    receive(bytes);
    stale = true;
  };
  const settle = () => {
    stale = false;
    if (page.ghost) ghost($("player-ghost").value);
    else look(page.camera.eye, page.camera.target);
    reveal();
    draw();
  };
  let before = null;
  const tick = (now) => {
    const dt = before === null ? 0 : Math.min(0.1, (now - before) / 1000);
    before = now;
    if (stale) settle();
    if (page.ghost && now < 20000) recede();
    if (state.playing) {
      const times = state.clip.times, end = times[times.length - 1];
      if (state.time >= end) {
        state.rest += dt; // rests at the end, then begins again
        if (state.rest > 0.8) { state.time = 0; state.rest = 0; }
      } else state.time = Math.min(end, state.time + dt * state.speed);
      draw();
    }
    const placed = [];
    page.arrows.forEach((arrow) => label(arrow, placed));
    requestAnimationFrame(tick);
  };

  // What a link asks for: replay.html#clip=2&time=1.5&ghost=beside
  const asked = new URLSearchParams(location.hash.slice(1));
  page.arrows.forEach(makeArrow);
  connect();
  state.speed = Number($("player-speed").value);
  const first = Number(asked.get("clip") || 0);
  $("player-clip").value = first;
  openClip(first);
  if (page.ghost && asked.has("ghost"))
    $("player-ghost").value = asked.get("ghost");
  if (asked.has("time")) {
    play(false);
    state.time = Number(asked.get("time"));
    draw();
  }
  if (viewer.gui) viewer.gui.close();
  requestAnimationFrame(tick);
})();
