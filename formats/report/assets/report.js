"use strict";
// The page stands without this script: it adds zooming, hovering, the slider, charts, the cloud.
(() => {
  const { select, zoom, zoomIdentity, uPlot } = libraries;
  const read = (id) => JSON.parse(document.getElementById(id).textContent);
  const data = read("data"), timing = read("timing-data");
  const byId = (id) => document.getElementById(id);
  const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  const nodes = data.nodes, count = nodes.id.length;
  const place = new Map(nodes.id.map((id, i) => [id, i]));
  const cards = new Set(data.cards);

  // --- light and dark: as the system wants it, until the button is used
  const root = document.documentElement, theme = byId("theme");
  const system = matchMedia("(prefers-color-scheme: dark)");
  const redraws = [];
  const paint = (dark) => {
    root.classList.toggle("dark", dark);
    theme.textContent = dark ? "light" : "dark";
    redraws.forEach((draw) => draw());
  };
  theme.hidden = false;
  theme.addEventListener("click", () => paint(!root.classList.contains("dark")));
  system.addEventListener("change", () => paint(system.matches));

  // --- layers
  const layer = (key) => document.querySelector(`g[data-layer="${key}"]`);
  const shown = (key) => layer(key) && !layer(key).hasAttribute("hidden");
  for (const box of document.querySelectorAll("#layers input")) {
    const apply = () => layer(box.dataset.layer).toggleAttribute("hidden", !box.checked);
    box.addEventListener("change", apply);
    apply();
  }

  // --- the map: pan and zoom
  const map = byId("map"), frame = byId("map-frame"), tip = byId("tip"), marks = byId("marks");
  const scale = +map.dataset.scale, left = +map.dataset.left, top = +map.dataset.top;
  const toPixels = (x, y) => [(x - left) * scale, (top - y) * scale];
  const svg = (name, attributes) => {
    const made = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    return made;
  };
  const bar = byId("scale-bar"), barText = bar.querySelector("text");
  const barLine = bar.querySelector("path"), foot = barLine.getAttribute("d").split("h")[0];
  const drawBar = () => { // the longest round length that is no longer than the first one
    const most = bar.dataset.metres / current.k, power = 10 ** Math.floor(Math.log10(most));
    const metres = [5, 2, 1].find((step) => step * power <= most * 1.0001) * power;
    barText.textContent = `${+metres.toPrecision(1)} m`;
    barLine.setAttribute("d", `${foot}h${metres * scale * current.k}`);
  };
  let current = zoomIdentity;
  const zoomed = (event) => {
    current = event.transform;
    byId("view").setAttribute("transform", current);
    drawBar();
    drawMarks();
  };
  const zooming = zoom().scaleExtent([1, 60])
    .filter((event) => event.type === "wheel" ? event.ctrlKey || event.metaKey || wheelOn
      : event.touches ? event.touches.length > 1 : !event.button)
    .on("zoom", zoomed);
  const target = select(map);
  let wheelOn = false; // a page scrolls over its map until the map was touched
  map.addEventListener("pointerdown", () => { wheelOn = true; });
  map.addEventListener("pointerleave", () => { wheelOn = false; });
  target.call(zooming).on("dblclick.zoom", null);
  byId("zoom").hidden = false;
  for (const button of byId("zoom").children) {
    button.addEventListener("click", () => {
      const by = +button.dataset.by;
      if (by) zooming.scaleBy(target, by); else zooming.transform(target, zoomIdentity);
    });
  }

  // --- what lies under the pointer
  const kindLayer = { loop_closure: "loop", proximity: "proximity", user: "user",
    landmark: "landmark" };
  const facts = {
    node: (i) => {
      const lines = [`node ${nodes.id[i]}` +
          (nodes.session ? ` of session ${nodes.session[i]}` : ""),
        `time ${nodes.t[i].toFixed(1)} s`,
        `x ${nodes.x[i].toFixed(2)} m, y ${nodes.y[i].toFixed(2)} m, ` +
          `yaw ${(nodes.yaw[i] * 180 / Math.PI).toFixed(1)}°`];
      if (nodes.sigma) lines.push(`sigma ${nodes.sigma[i].toFixed(3)} m`);
      const mine = data.constraints.filter((c) => c[0] === nodes.id[i] || c[1] === nodes.id[i]);
      lines.push(`${mine.filter((c) => c[3]).length} constraints accepted, ` +
        `${mine.filter((c) => !c[3]).length} rejected`);
      return lines.join("\n");
    },
    constraint: (k) => {
      const [a, b, kind, accepted, metres, degrees, sigmas, reason] = data.constraints[k];
      const lines = [`${a} and ${b}: ${data.kinds[kind].replace("_", " ")}, ` +
        (accepted ? "accepted" : "rejected")];
      if (metres !== null) lines.push(`residual ${metres} m, ${degrees}° (${sigmas} sigma)`);
      if (data.reasons[reason]) lines.push(data.reasons[reason]);
      return lines.join("\n");
    },
  };
  const ends = data.constraints.map((c) => {
    const i = place.get(c[0]), j = place.get(c[1]);
    if (i === undefined || j === undefined || i === j) return null;
    return [...toPixels(nodes.x[i], nodes.y[i]), ...toPixels(nodes.x[j], nodes.y[j])];
  });
  const spots = nodes.id.map((_, i) => toPixels(nodes.x[i], nodes.y[i]));
  const visible = (c) => {
    const key = kindLayer[data.kinds[c[2]]] || data.kinds[c[2]];
    return c[3] ? key && shown(key) : shown("rejected");
  };
  const distance = ([ax, ay, bx, by], x, y) => {
    const dx = bx - ax, dy = by - ay, length = dx * dx + dy * dy;
    const s = length ? Math.max(0, Math.min(1, ((x - ax) * dx + (y - ay) * dy) / length)) : 0;
    return Math.hypot(x - ax - s * dx, y - ay - s * dy);
  };
  const under = (x, y, reach) => {
    let best = null, nearest = reach;
    if (shown("path") || shown("nodes")) {
      spots.forEach(([u, v], i) => {
        const d = Math.hypot(u - x, v - y);
        if (d < nearest) { nearest = d; best = ["node", i]; }
      });
    }
    // A line that leads to a node is meant where the pointer is beside it, not on the node.
    if (best && nearest < 0.45 * reach) return best;
    data.constraints.forEach((c, k) => {
      if (!ends[k] || !visible(c)) return;
      const d = distance(ends[k], x, y);
      if (d < nearest) { nearest = d; best = ["constraint", k]; }
    });
    return best;
  };
  let picked = null, pinned = false;
  const at = (event) => {
    const box = map.getBoundingClientRect(), view = map.viewBox.baseVal;
    const fit = Math.min(box.width / view.width, box.height / view.height);
    const x = (event.clientX - box.left - (box.width - view.width * fit) / 2) / fit;
    const y = (event.clientY - box.top - (box.height - view.height * fit) / 2) / fit;
    const [u, v] = current.invert([x, y]);
    return { x: u, y: v, reach: 9 / fit / current.k };
  };
  const show = (found, event) => {
    picked = found;
    drawMarks();
    tip.hidden = !found;
    tip.classList.toggle("pinned", pinned && !!found);
    if (!found) return;
    tip.textContent = facts[found[0]](found[1]);
    if (found[0] === "constraint" && cards.has(found[1])) {
      const link = document.createElement("a");
      link.href = `#c${found[1]}`;
      link.textContent = pinned ? "see the evidence" : "click for the evidence";
      tip.append("\n", link);
    }
    const box = frame.getBoundingClientRect();
    const x = event.clientX - box.left, y = event.clientY - box.top;
    tip.style.left = `${Math.max(4, Math.min(x + 12, box.width - tip.offsetWidth - 4))}px`;
    tip.style.top = `${y + 14 + tip.offsetHeight > box.height
      ? Math.max(4, y - tip.offsetHeight - 10) : y + 14}px`;
  };
  map.addEventListener("pointermove", (event) => {
    if (pinned || event.buttons) return;
    const { x, y, reach } = at(event);
    show(under(x, y, reach), event);
  });
  map.addEventListener("pointerleave", () => { if (!pinned) show(null); });
  map.addEventListener("click", (event) => {
    const { x, y, reach } = at(event);
    const found = under(x, y, 1.5 * reach);
    pinned = !!found;
    show(found, event);
  });

  // --- edits to copy
  const copied = async (text) => {
    try {
      await navigator.clipboard.writeText(text);
    } catch { // a page that was opened from a file may not
      const field = document.createElement("textarea");
      field.value = text;
      document.body.append(field);
      field.select();
      document.execCommand("copy");
      field.remove();
    }
  };
  for (const button of document.querySelectorAll("button.edit")) {
    const label = button.textContent;
    button.hidden = false;
    button.addEventListener("click", async () => {
      await copied(button.dataset.edit);
      button.textContent = "copied";
      setTimeout(() => { button.textContent = label; }, 1500);
    });
  }

  // --- time
  const moment = byId("moment"), clock = byId("clock"), seen = byId("seen");
  const lastTime = data.path.length ? data.path[data.path.length - 1][0] : nodes.t[count - 1] || 0;
  let now = 0;
  const latest = (list, t, of) => { // place of the last entry that is not after t
    let a = 0, b = list.length - 1;
    while (a < b) { const m = (a + b + 1) >> 1; if (of(list[m]) <= t) a = m; else b = m - 1; }
    return a;
  };
  const pictures = nodes.id.map((id, i) => [id, nodes.t[i]]).filter(([id]) => data.pictures[id]);
  const showTime = () => {
    now = (clock.value / 1000) * lastTime;
    const i = latest(nodes.t, now, (t) => t);
    moment.textContent = `${now.toFixed(1)} s of ${lastTime.toFixed(0)} s, node ${nodes.id[i]}` +
      (nodes.sigma ? `, sigma ${nodes.sigma[i].toFixed(3)} m` : "");
    drawMarks();
    seen.hidden = !pictures.length;
    if (!pictures.length) return;
    const [id] = pictures[latest(pictures, now, (p) => p[1])];
    const [width, height] = data.pictures[id];
    if (seen.dataset.id === String(id)) return;
    seen.dataset.id = id;
    const view = svg("svg", { viewBox: `0 0 ${width} ${height}` });
    view.append(svg("use", { href: `#image${id}` }));
    const caption = document.createElement("figcaption");
    caption.textContent = `what node ${id} saw`;
    seen.replaceChildren(view, caption);
  };
  const drawMarks = () => {
    const parts = [];
    if (picked && picked[0] === "node") {
      const [x, y] = spots[picked[1]];
      parts.push(svg("path", { class: "picked", d: `M${x} ${y}h0`, "stroke-width": 10 }));
      parts[0].style.strokeWidth = 11;
    } else if (picked) {
      const [a, b, c, d] = ends[picked[1]];
      parts.push(svg("path", { class: "picked", d: `M${a} ${b}L${c} ${d}` }));
    }
    if (now > 0 && data.path.length) {
      const [, px, py] = data.path[latest(data.path, now, (p) => p[0])];
      const i = latest(nodes.t, now, (t) => t), [x, y] = toPixels(px, py);
      const turn = -nodes.yaw[i] * 180 / Math.PI, size = 1 / current.k;
      parts.push(svg("path", { class: "robot", d: "M14 0L-8 8L-4 0L-8 -8Z",
        transform: `translate(${x} ${y}) rotate(${turn}) scale(${size})` }));
    }
    marks.replaceChildren(...parts);
  };
  if (count > 1) {
    byId("time").hidden = false;
    clock.addEventListener("input", showTime);
    let playing = 0;
    byId("play").addEventListener("click", (event) => {
      const stop = () => { clearInterval(playing); playing = 0; event.target.textContent = "▶"; };
      if (playing) return stop();
      if (+clock.value >= 1000) clock.value = 0;
      event.target.textContent = "❚❚";
      playing = setInterval(() => {
        clock.value = +clock.value + 4;
        showTime();
        if (+clock.value >= 1000) stop();
      }, 40);
    });
    showTime();
  }

  // --- charts
  const axis = (label) => ({ stroke: css("--soft"), grid: { stroke: css("--line"), width: 1 },
    ticks: { stroke: css("--line") }, label, labelSize: 18, labelFont: "12px system-ui" });
  const chart = (id, labels, options, series) => {
    const host = byId(id);
    if (!host) return;
    let made = null;
    const draw = () => {
      if (made) made.destroy();
      const width = host.clientWidth || 600;
      made = new uPlot({ width, height: 220, axes: labels.map(axis), ...options() }, series, host);
    };
    draw();
    redraws.push(draw);
    new ResizeObserver(() => {
      if (made && Math.abs(made.width - host.clientWidth) > 2) {
        made.setSize({ width: host.clientWidth, height: 220 });
      }
    }).observe(host);
  };
  if (nodes.sigma) {
    chart("chart-sigma", ["time, s", "one sigma, m"], () => ({
      scales: { x: { time: false } },
      series: [{ label: "time, s" }, { label: "one sigma of the position, m",
        stroke: css("--sigma"), width: 1.5, value: (_, v) => v === null ? "" : v.toFixed(3) }],
    }), [nodes.t, nodes.sigma]);
  }
  const drawResiduals = () => {
    const edges = Array.from({ length: 26 }, (_, i) => i * 0.2);
    const columns = [], names = [];
    data.kinds.forEach((kind, k) => {
      const mine = data.constraints.filter((c) => c[2] === k && c[3] && c[6] !== null);
      if (!mine.length) return;
      const bins = edges.map(() => 0);
      for (const c of mine) bins[Math.min(25, Math.floor(c[6] / 0.2))] += 100 / mine.length;
      columns.push(bins);
      names.push([kind.replace("_", " "), mine.length]);
    });
    const colours = { neighbour: "--path", "loop closure": "--loop", proximity: "--proximity" };
    chart("chart-residuals", ["residual, sigmas", "share of the kind, %"], () => ({
      scales: { x: { time: false } },
      series: [{ label: "residual, sigmas" }, ...names.map(([name, n]) => ({
        label: `${name} (${n}), %`, stroke: css(colours[name] || "--user"), width: 1.5,
        points: { show: false }, paths: uPlot.paths.stepped({ align: 1 }), value: (_, v) => v === null ? "" : v.toFixed(1),
      }))],
    }), [edges, ...columns]);
  };
  drawResiduals();

  // --- time and memory
  if (timing && byId("timing")) {
    const rows = [["stage", "seconds", "CPU seconds", "peak memory, MB"],
      ...timing.stages.map((s) => [s.name, s.wall_s.toFixed(1), s.cpu_s.toFixed(1),
        s.peak_memory_mb.toFixed(0)])];
    const grid = document.createElement("table");
    rows.forEach((row, i) => {
      const line = grid.insertRow();
      row.forEach((text, j) => {
        const cell = document.createElement(i ? "td" : "th");
        cell.textContent = text;
        if (j) cell.className = "number";
        line.append(cell);
      });
    });
    const words = document.createElement("p");
    words.textContent = (timing.built ? `Built ${timing.built}. ` : "") + `${timing.wall_s.toFixed(1)} s` +
      (timing.duration_s ? ` for ${timing.duration_s.toFixed(0)} s of log` : "") + `, ${timing.cpu_s.toFixed(1)} CPU s, ${timing.peak_memory_mb.toFixed(0)} MB at most. ` +
      "These figures are of one build on one machine and no part of the map.";
    byId("timing").append(grid, words);
  }

  // --- the cloud
  const bytes = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const canvas = byId("cloud");
  const showCloud = () => {
    const { Renderer, Camera, Transform, Program, Mesh, Geometry, Orbit, Vec3 } = libraries;
    const cloud = read("cloud-data");
    let renderer;
    try {
      renderer = new Renderer({ canvas, dpr: Math.min(2, devicePixelRatio), alpha: true,
        preserveDrawingBuffer: true });
    } catch {
      canvas.replaceWith("This browser shows no 3D: see the cloud in the .ply file.");
      return;
    }
    const { gl } = renderer;
    const raw = new Uint16Array(bytes(cloud.points).buffer);
    const position = Float32Array.from(raw, (v) => v * cloud.unit);
    const low = [Infinity, Infinity, Infinity], high = [0, 0, 0];
    position.forEach((v, i) => {
      low[i % 3] = Math.min(low[i % 3], v);
      high[i % 3] = Math.max(high[i % 3], v);
    });
    const rgb = cloud.colours ? bytes(cloud.colours) : null;
    const colour = new Float32Array(position.length);
    for (let i = 0; i < colour.length; i += 1) {
      const z = (position[i - (i % 3) + 2] - low[2]) / Math.max(high[2] - low[2], 1e-3);
      colour[i] = rgb ? rgb[i] / 255 : [0.35 + 0.6 * z, 0.75, 1 - 0.6 * z][i % 3];
    }
    const program = new Program(gl, {
      vertex: `attribute vec3 position; attribute vec3 colour; uniform mat4 modelViewMatrix;
        uniform mat4 projectionMatrix; uniform float size; varying vec3 shade;
        void main() { shade = colour; vec4 seen = modelViewMatrix * vec4(position, 1.0);
          gl_Position = projectionMatrix * seen;
          gl_PointSize = clamp(size / -seen.z, 1.5, 12.0); }`,
      fragment: `precision mediump float; varying vec3 shade;
        void main() { gl_FragColor = vec4(shade, 1.0); }`,
      uniforms: { size: { value: 30 } },
    });
    const middle = low.map((v, i) => (v + high[i]) / 2);
    const span = Math.max(...high.map((v, i) => v - low[i]), 0.5);
    const scene = new Transform(), turned = new Transform();
    turned.setParent(scene);
    turned.rotation.x = -Math.PI / 2; // z of the map is up
    const mesh = new Mesh(gl, { mode: gl.POINTS, program, geometry: new Geometry(gl, {
      position: { size: 3, data: position }, colour: { size: 3, data: colour } }) });
    mesh.position.set(...middle.map((v) => -v));
    mesh.frustumCulled = false;
    mesh.setParent(turned);
    const camera = new Camera(gl, { fov: 45, near: span / 500, far: span * 20 });
    // All of it is seen, also where the window is narrow.
    const away = 0.8 * span * Math.max(1, 1.2 * canvas.clientHeight / canvas.clientWidth);
    camera.position.set(0, away, away);
    const orbit = new Orbit(camera, { element: canvas, target: new Vec3(0, 0, 0), ease: 0.3,
      inertia: 0.6 });
    const fit = () => {
      const width = canvas.clientWidth, height = canvas.clientHeight;
      renderer.setSize(width, height);
      canvas.style.width = canvas.style.height = "";
      camera.perspective({ aspect: width / height });
      program.uniforms.size.value = 0.012 * height * renderer.dpr;
    };
    // Drawn while it is moved and a moment longer, for a turn to run out; a still page rests.
    const settles = 1500; // ms
    let until = 0, drawing = false;
    const draw = () => {
      orbit.update();
      renderer.render({ scene, camera });
      drawing = performance.now() < until;
      if (drawing) requestAnimationFrame(draw);
    };
    const wake = () => {
      until = performance.now() + settles;
      if (!drawing) requestAnimationFrame(draw);
      drawing = true;
    };
    const touched = ["mousedown", "wheel", "touchstart", "touchmove"];
    touched.forEach((name) => canvas.addEventListener(name, wake, { passive: true }));
    addEventListener("mousemove", (event) => event.buttons && wake());
    fit();
    draw();
    new ResizeObserver(() => { fit(); wake(); }).observe(canvas);
    canvas.dataset.ready = "yes";
  };
  if (canvas) {
    const once = () => {
      watch.disconnect();
      if (!canvas.dataset.ready) showCloud();
    };
    const watch = new IntersectionObserver(([entry]) => entry.isIntersecting && once());
    watch.observe(canvas);
    addEventListener("beforeprint", once); // paper has no place that is scrolled to
  }
  paint(system.matches);
  root.dataset.ready = "yes";
})();
