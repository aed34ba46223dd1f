"use strict";
(() => {
  const $ = (id) => document.getElementById(id);
  const canvas = $("map"), stick = $("stick"), knob = stick.firstElementChild;
  const draw2d = canvas.getContext("2d");
  const DRIVE_PERIOD = 100; // ms; the robot stops half a second after the last command
  const RETRY_PERIOD = 1000; // ms
  const SILENCE = 5000; // ms; devices are shown every second. A network that is lost is noticed only after minutes
  const MIN_SCALE = 1, MAX_SCALE = 1000; // pixels per metre
  const parts = {};
  let socket = null, dirty = true, answer = false, heard = 0, silent = false;
  let view = { x: 0, y: 0, scale: 40 }, mode = "fit"; // metres in the map at the middle; fit, follow or free

  // Connection

  const send = (content) => {
    if (socket && socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify(content));
  };
  const connect = () => {
    socket = new WebSocket(`ws://${location.host}/live${location.search}`);
    let isFirst = true;
    socket.onmessage = (message) => {
      if (isFirst) for (const name of Object.keys(parts)) delete parts[name]; // it may be another run
      isFirst = false;
      Object.assign(parts, JSON.parse(message.data));
      $("grid").hidden = !Object.keys(parts).some((name) => name.startsWith("tile "));
      dirty = answer = true;
      heard = performance.now();
    };
    socket.onopen = () => {
      document.body.classList.add("connected");
      dirty = true;
      heard = performance.now();
    };
    socket.onclose = () => {
      document.body.classList.remove("connected");
      release();
      dirty = true;
      setTimeout(connect, RETRY_PERIOD);
    };
  };

  // Texts

  const clock = (seconds) => `${Math.floor(seconds / 60)}:${String(Math.floor(seconds % 60)).padStart(2, "0")}`;
  const list = (id, rows) => {
    const items = rows.map(([name, time, text]) => {
      const item = document.createElement("li");
      item.className = name;
      if (time !== null) item.append(Object.assign(document.createElement("time"), { textContent: clock(time) }));
      item.append(text);
      return item;
    });
    if (!items.length) items.push(Object.assign(document.createElement("li"), { className: "none", textContent: "none" }));
    $(id).replaceChildren(...items);
  };
  const facts = (entries) => {
    $("facts").replaceChildren(...Object.entries(entries).map(([name, value]) => {
      const entry = document.createElement("div");
      entry.append(
        Object.assign(document.createElement("dt"), { textContent: name }),
        Object.assign(document.createElement("dd"), { textContent: value }),
      );
      return entry;
    }));
  };
  /** Standard deviation of the position in its worst direction, as text. */
  const sigma = () => {
    if (!parts.pose.covariance) return "";
    const [[a, b], [, c]] = parts.pose.covariance;
    return ` ± ${(100 * Math.sqrt((a + c) / 2 + Math.hypot((a - c) / 2, b))).toFixed(1)} cm`;
  };
  let shownStatus = null;
  const showTexts = () => {
    const connected = document.body.classList.contains("connected"), status = parts.status;
    const online = connected && !silent;
    const pose = parts.pose && parts.pose.pose;
    $("pose").textContent = pose
      ? `${pose[0].toFixed(2)} m, ${pose[1].toFixed(2)} m, ${Math.round(pose[2] * 180 / Math.PI)}°${sigma()}` : "";
    if (!status) return;
    const ended = status.finished ? "the run is over" : connected ? "no data from the robot" : "no connection";
    const lost = (status.devices || []).filter(([, state]) => state === "lost").map(([name]) => `${name} is lost; `).join("");
    $("note").textContent = online && !status.finished ? lost + (status.paused ? "paused; " : "") + (status.frozen ? "only localising; " : "") + status.message : ended;
    $("state").textContent = status.state;
    $("state").className = `badge ${online || status.finished ? status.state : ""}`;
    if (shownStatus === status) return;
    shownStatus = status;
    $("save").hidden = !status.can_save;
    $("freeze").hidden = !status.can_freeze;
    $("freeze").textContent = status.frozen ? "Extend map" : "Only localise";
    $("freeze").setAttribute("aria-pressed", String(status.frozen));
    $("pause").hidden = !status.can_pause;
    $("pause").textContent = status.paused ? "Continue" : "Pause";
    $("pause").setAttribute("aria-pressed", String(status.paused));
    stick.hidden = !status.can_drive;
    facts({ ...status.counts, ...(parts.scan && parts.scan.overlap !== null ? { overlap: `${Math.round(100 * parts.scan.overlap)} %` } : {}) });
    list("doubts", [...status.doubts].reverse().map(([time, text]) => ["", time, text]));
    list("closures", [...status.closures].reverse().map(([time, name, text]) => [name, time, `${name}: ${text}`]));
    list("devices", (status.devices || []).map(([name, state, faults]) =>
      [faults || state !== "running" ? "fault" : "", null, `${name}: ${state}${faults ? `, ${faults}` : ""}`]));
  };

  // Occupancy grid: a small picture for each tile, drawn anew if the tile is

  const COLOURS = [[0, 0, 0, 0], [226, 235, 243, 255], [132, 144, 156, 255]]; // unknown, free, occupied
  const pictures = new Map();
  const picture = (name, tile) => {
    const before = pictures.get(name);
    if (before && before.tile === tile) return before.canvas;
    const codes = atob(tile.cells), shown = document.createElement("canvas"); // browsers of tablets are often old
    shown.width = shown.height = tile.count;
    const image = new ImageData(tile.count, tile.count);
    for (let k = 0; k < tile.count ** 2; k++) {
      image.data.set(COLOURS[(codes.charCodeAt(k >> 2) >> (2 * (k & 3))) & 3], 4 * k);
    }
    shown.getContext("2d").putImageData(image, 0, 0);
    pictures.set(name, { tile, canvas: shown });
    return shown;
  };
  const drawGrid = (ratio) => {
    if ($("grid").getAttribute("aria-pressed") !== "true") return;
    for (const [name, tile] of Object.entries(parts)) {
      if (!name.startsWith("tile ")) continue;
      draw2d.imageSmoothingEnabled = ratio * view.scale * tile.size < tile.count; // only if cells are below a pixel
      draw2d.drawImage(picture(name, tile), tile.x, tile.y, tile.size, tile.size);
    }
  };

  // Map

  const bounds = () => {
    const box = [Infinity, Infinity, -Infinity, -Infinity];
    const add = (x, y) => {
      box[0] = Math.min(box[0], x); box[1] = Math.min(box[1], y);
      box[2] = Math.max(box[2], x); box[3] = Math.max(box[3], y);
    };
    for (const part of [parts.map, parts.recent]) {
      for (const [x, y, u, v] of part ? part.walls : []) { add(x, y); add(u, v); }
      for (const [x, y] of part ? part.path : []) add(x, y);
    }
    if (parts.pose) add(parts.pose.pose[0], parts.pose.pose[1]);
    return box[0] <= box[2] ? box : [-3, -3, 3, 3];
  };
  const place = (width, height) => {
    if (mode === "fit") {
      const [left, low, right, high] = bounds();
      view = {
        x: (left + right) / 2,
        y: (low + high) / 2,
        scale: Math.min(200, 0.88 * Math.min(width / (right - left + 0.5), height / (high - low + 0.5))),
      };
    } else if (mode === "follow" && parts.pose) {
      [view.x, view.y] = parts.pose.pose;
    }
  };
  const lines = (walls, colour, width) => {
    draw2d.beginPath();
    for (const [x, y, u, v] of walls) { draw2d.moveTo(x, y); draw2d.lineTo(u, v); }
    draw2d.strokeStyle = colour;
    draw2d.lineWidth = width / view.scale;
    draw2d.stroke();
  };
  const drawRobot = ({ pose: [x, y, heading], covariance }) => {
    if (covariance) {
      const [[a, b], [, c]] = covariance, mean = (a + c) / 2, spread = Math.hypot((a - c) / 2, b);
      draw2d.beginPath();
      draw2d.ellipse(x, y, 3 * Math.sqrt(mean + spread), 3 * Math.sqrt(Math.max(mean - spread, 0)),
        Math.atan2(2 * b, a - c) / 2, 0, 2 * Math.PI);
      draw2d.fillStyle = "#0072b233";
      draw2d.fill();
    }
    const size = Math.max(0.18, 9 / view.scale);
    draw2d.save();
    draw2d.translate(x, y);
    draw2d.rotate(heading);
    draw2d.beginPath();
    draw2d.moveTo(1.3 * size, 0);
    draw2d.lineTo(-0.8 * size, 0.8 * size);
    draw2d.lineTo(-0.4 * size, 0);
    draw2d.lineTo(-0.8 * size, -0.8 * size);
    draw2d.closePath();
    draw2d.fillStyle = "#0072b2";
    draw2d.fill();
    draw2d.restore();
  };
  const drawMap = () => {
    const ratio = devicePixelRatio, width = canvas.clientWidth, height = canvas.clientHeight;
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
    }
    place(width, height);
    draw2d.setTransform(1, 0, 0, 1, 0, 0);
    draw2d.clearRect(0, 0, canvas.width, canvas.height);
    const pixels = ratio * view.scale;
    draw2d.setTransform(pixels, 0, 0, -pixels, ratio * width / 2 - pixels * view.x, ratio * height / 2 + pixels * view.y);
    drawGrid(ratio);
    draw2d.lineCap = draw2d.lineJoin = "round";
    const path = [...(parts.map ? parts.map.path : []), ...(parts.recent ? parts.recent.path : [])];
    draw2d.beginPath();
    path.forEach(([x, y], k) => (k ? draw2d.lineTo(x, y) : draw2d.moveTo(x, y)));
    draw2d.strokeStyle = "#56b4e9";
    draw2d.lineWidth = 1.5 / view.scale;
    draw2d.stroke();
    if (parts.recent) lines(parts.recent.walls, "#8a95a1", 1.5);
    if (parts.map) lines(parts.map.walls, "#1f2933", 2);
    if (parts.scan && !(parts.status && parts.status.finished)) {
      const dot = 2.5 / view.scale;
      draw2d.fillStyle = "#d55e00";
      for (const [x, y] of parts.scan.points) draw2d.fillRect(x - dot / 2, y - dot / 2, dot, dot);
    }
    if (parts.pose) drawRobot(parts.pose);
    const longest = 120 / view.scale, power = 10 ** Math.floor(Math.log10(longest));
    const metres = [5, 2, 1].map((digit) => digit * power).find((length) => length <= longest);
    const scale = document.querySelector(".scale");
    scale.firstElementChild.style.width = `${metres * view.scale}px`;
    scale.lastElementChild.textContent = metres >= 1 ? `${metres} m` : `${Math.round(1000 * metres) / 10} cm`;
  };
  const show = () => {
    if (silent !== (performance.now() > heard + SILENCE)) {
      silent = !silent;
      dirty = true;
    }
    if (dirty) {
      dirty = false;
      showTexts();
      drawMap();
    }
    if (answer) {
      answer = false;
      send({ drawn: 1 }); // asks for the next frame: a hidden page gets none
    }
    requestAnimationFrame(show);
  };

  // Zoom and pan

  const setMode = (wanted) => {
    mode = wanted;
    $("fit").setAttribute("aria-pressed", String(mode === "fit"));
    $("follow").setAttribute("aria-pressed", String(mode === "follow"));
    dirty = true;
  };
  const zoom = (factor, x = canvas.clientWidth / 2, y = canvas.clientHeight / 2) => {
    const scale = Math.min(MAX_SCALE, Math.max(MIN_SCALE, view.scale * factor));
    const dx = (x - canvas.clientWidth / 2) * (1 / view.scale - 1 / scale);
    const dy = (y - canvas.clientHeight / 2) * (1 / view.scale - 1 / scale);
    view = { x: view.x + dx, y: view.y - dy, scale };
    setMode(mode === "follow" ? "follow" : "free");
  };
  const move = (dx, dy) => {
    view = { ...view, x: view.x - dx / view.scale, y: view.y + dy / view.scale };
    setMode("free");
  };
  const pointers = new Map();
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, [event.offsetX, event.offsetY]);
  });
  canvas.addEventListener("pointermove", (event) => {
    const before = pointers.get(event.pointerId);
    if (!before) return;
    const now = [event.offsetX, event.offsetY];
    if (pointers.size === 1) move(now[0] - before[0], now[1] - before[1]);
    pointers.set(event.pointerId, now);
    if (pointers.size === 2) {
      const other = [...pointers].find(([id]) => id !== event.pointerId)[1];
      const gap = (point) => Math.hypot(point[0] - other[0], point[1] - other[1]);
      move((now[0] - before[0]) / 2, (now[1] - before[1]) / 2);
      if (gap(before) > 10) zoom(gap(now) / gap(before), (now[0] + other[0]) / 2, (now[1] + other[1]) / 2);
    }
  });
  for (const name of ["pointerup", "pointercancel"]) {
    canvas.addEventListener(name, (event) => pointers.delete(event.pointerId));
  }
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(Math.exp(-event.deltaY * (event.deltaMode ? 0.05 : 0.0015)), event.offsetX, event.offsetY);
  }, { passive: false });
  for (const button of document.querySelectorAll("[data-zoom]")) {
    button.addEventListener("click", () => zoom(Number(button.dataset.zoom)));
  }
  $("fit").addEventListener("click", () => setMode("fit"));
  $("follow").addEventListener("click", () => setMode("follow"));
  $("grid").addEventListener("click", () => {
    $("grid").setAttribute("aria-pressed", String($("grid").getAttribute("aria-pressed") !== "true"));
    dirty = true;
  });
  new ResizeObserver(() => { dirty = true; }).observe(canvas);

  // Buttons and driving

  $("save").addEventListener("click", () => send({ save: true }));
  $("freeze").addEventListener("click", () => send({ freeze: !parts.status.frozen }));
  $("pause").addEventListener("click", () => send({ pause: !parts.status.paused }));
  let command = [0, 0]; // shares of the limits: forwards, counter-clockwise
  const drive = (forwards, left) => {
    const stops = command.some(Boolean) && !forwards && !left;
    command = [forwards, left];
    knob.style.transform = `translate(${-45 * left}px, ${-45 * forwards}px)`;
    if (stops) sendCommand();
  };
  const sendCommand = () => send({ drive: command, time: performance.now() });
  const pressed = new Set();
  const release = () => { pressed.clear(); drive(0, 0); };
  setInterval(() => { if (command.some(Boolean)) sendCommand(); }, DRIVE_PERIOD);
  const aim = (event) => {
    const box = stick.getBoundingClientRect(), radius = box.width / 2;
    const right = (event.clientX - box.left) / radius - 1, up = 1 - (event.clientY - box.top) / radius;
    const size = Math.max(1, Math.hypot(right, up));
    drive(up / size, -right / size);
  };
  let finger = null;
  stick.addEventListener("pointerdown", (event) => {
    finger = event.pointerId;
    stick.setPointerCapture(finger);
    aim(event);
    sendCommand();
  });
  stick.addEventListener("pointermove", (event) => { if (event.pointerId === finger) aim(event); });
  for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) {
    stick.addEventListener(name, () => { finger = null; release(); });
  }
  const KEYS = { ArrowUp: [1, 0], ArrowDown: [-1, 0], ArrowLeft: [0, 1], ArrowRight: [0, -1] };
  addEventListener("keydown", (event) => {
    if (stick.hidden) return;
    if (event.key === " " && command.some(Boolean)) release();
    else if (KEYS[event.key]) pressed.add(event.key);
    else return;
    event.preventDefault();
    steer();
  });
  addEventListener("keyup", (event) => { if (pressed.delete(event.key)) steer(); });
  const steer = () => {
    const sum = [...pressed].reduce(([v, w], key) => [v + KEYS[key][0], w + KEYS[key][1]], [0, 0]);
    const starts = !command.some(Boolean) && sum.some(Boolean);
    drive(...sum);
    if (starts) sendCommand();
  };
  addEventListener("blur", release);
  document.addEventListener("visibilitychange", () => { if (document.hidden) release(); });

  connect();
  requestAnimationFrame(show);
})();
