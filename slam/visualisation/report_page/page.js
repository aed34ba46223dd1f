"use strict";
(() => {
  const svg = document.querySelector("#map svg");
  const about = document.getElementById("about");
  const scale = document.querySelector(".scale");
  const [left, top, width, height] = svg.getAttribute("viewBox").split(" ").map(Number);
  const all = { x: left, y: top, width, height };
  const MAX_ZOOM = 200, MIN_ZOOM = 1; // relative to the whole map
  let view = { ...all };

  const show = () => {
    svg.setAttribute("viewBox", [view.x, view.y, view.width, view.height].map((v) => v.toFixed(4)).join(" "));
    // The whole map cannot be dragged, so a finger scrolls the page.
    svg.style.touchAction = view.width < 0.99 * all.width ? "none" : "pan-y";
    const pixels = svg.getScreenCTM().a; // per metre
    const longest = 120 / pixels;
    const power = 10 ** Math.floor(Math.log10(longest));
    const metres = [5, 2, 1].map((digit) => digit * power).find((length) => length <= longest);
    scale.hidden = false;
    scale.firstElementChild.style.width = `${metres * pixels}px`;
    scale.lastElementChild.textContent = metres >= 1 ? `${metres} m` : `${Math.round(1000 * metres) / 10} cm`;
  };

  const inMap = (x, y) => new DOMPoint(x, y).matrixTransform(svg.getScreenCTM().inverse());
  const middle = () => {
    const box = svg.getBoundingClientRect();
    return [box.left + box.width / 2, box.top + box.height / 2];
  };

  /** Scale by 1 / factor about the point under (x, y). */
  const zoom = (factor, x, y) => {
    const wanted = Math.min(all.width / MIN_ZOOM, Math.max(all.width / MAX_ZOOM, view.width * factor));
    const real = wanted / view.width;
    const at = inMap(x, y);
    view = {
      x: at.x - (at.x - view.x) * real,
      y: at.y - (at.y - view.y) * real,
      width: view.width * real,
      height: view.height * real,
    };
    if (real > 1) clampView();
    show();
  };
  const move = (dx, dy) => {
    const pixels = svg.getScreenCTM().a;
    view.x -= dx / pixels;
    view.y -= dy / pixels;
    clampView();
    show();
  };
  /** Keep the map within the frame. */
  const clampView = () => {
    view.x = Math.min(all.x + all.width - view.width, Math.max(all.x, view.x));
    view.y = Math.min(all.y + all.height - view.height, Math.max(all.y, view.y));
  };

  // Buttons, wheel, keys
  for (const button of document.querySelectorAll("[data-zoom]")) {
    button.addEventListener("click", () => {
      const factor = Number(button.dataset.zoom);
      if (factor) return zoom(factor, ...middle());
      view = { ...all };
      show();
    });
  }
  svg.addEventListener("wheel", (event) => {
    if (!event.ctrlKey && document.activeElement !== svg) return; // the page scrolls unless the map has the focus
    event.preventDefault();
    zoom(Math.exp(0.0015 * Math.max(-200, Math.min(200, event.deltaY))), event.clientX, event.clientY);
  }, { passive: false });
  svg.addEventListener("keydown", (event) => {
    const by = { ArrowLeft: [60, 0], ArrowRight: [-60, 0], ArrowUp: [0, 60], ArrowDown: [0, -60] }[event.key];
    const factor = { "+": 0.7, "-": 1.43 }[event.key];
    if (by) move(...by);
    else if (factor) zoom(factor, ...middle());
    else return;
    event.preventDefault();
  });

  // One pointer drags, two pinch
  const down = new Map();
  let dragged = 0;
  svg.addEventListener("pointerdown", (event) => {
    down.set(event.pointerId, event);
    dragged = down.size > 1 ? Infinity : 0;
  });
  svg.addEventListener("pointermove", (event) => {
    const before = down.get(event.pointerId);
    if (!before) return;
    const dx = event.clientX - before.clientX, dy = event.clientY - before.clientY;
    dragged += Math.hypot(dx, dy);
    if (down.size === 2) {
      const [other] = [...down.values()].filter((pointer) => pointer.pointerId !== event.pointerId);
      const distance = (pointer) => Math.hypot(pointer.clientX - other.clientX, pointer.clientY - other.clientY);
      const factor = distance(before) / Math.max(1, distance(event));
      zoom(factor, (event.clientX + other.clientX) / 2, (event.clientY + other.clientY) / 2);
      move(dx / 2, dy / 2);
    } else if (dragged > 4 && (event.pointerType === "mouse" || view.width < 0.99 * all.width)) {
      svg.classList.add("moving");
      svg.setPointerCapture(event.pointerId);
      move(dx, dy);
    }
    down.set(event.pointerId, event);
  });
  const up = (event) => {
    down.delete(event.pointerId);
    svg.classList.remove("moving");
  };
  svg.addEventListener("pointerup", up);
  svg.addEventListener("pointercancel", up);
  svg.addEventListener("lostpointercapture", up);

  // Measurements of two walls, as in slam/measuring/measurement.py
  const joint = JSON.parse(document.getElementById("joint")?.textContent ?? "null");
  let chosenWall = -1;
  if (joint) joint.covariance = new DataView(Uint8Array.from(atob(joint.covariance), (c) => c.charCodeAt(0)).buffer);
  /** Return the covariance of two of the 2 n values: offset and heading of each wall. */
  const covariance = (one, other) => {
    const row = Math.min(one, other), column = Math.max(one, other), size = 2 * joint.identity.length;
    return joint.covariance.getFloat32(4 * (row * size - (row * (row - 1)) / 2 + column - row), true);
  };
  /** Return the standard deviation of a quantity with a gradient, by index of the value. */
  const deviation = (gradient) => {
    let variance = 0;
    for (const [one, a] of gradient) for (const [other, b] of gradient) variance += a * b * covariance(one, other);
    return Math.sqrt(Math.max(variance, 0));
  };
  const alongWall = (wall, [x, y]) => {
    const [x0, y0, heading] = joint.frame[wall];
    return Math.cos(heading) * (x - x0) + Math.sin(heading) * (y - y0);
  };
  const onWall = (wall, along) => {
    const [x, y, heading] = joint.frame[wall];
    return [x + along * Math.cos(heading), y + along * Math.sin(heading)];
  };
  /** Return distance and standard deviation, metres, of two parallel walls in the middle of what they share. */
  const distance = (first, second) => {
    const dot = ([a, b], [c, d]) => a * c + b * d;
    const normal = (wall) => [-Math.sin(joint.frame[wall][2]), Math.cos(joint.frame[wall][2])];
    const one = normal(first), other = normal(second), sign = dot(one, other) > 0 ? 1 : -1;
    const length = Math.hypot(one[0] + sign * other[0], one[1] + sign * other[1]);
    const across = [(one[0] + sign * other[0]) / length, (one[1] + sign * other[1]) / length];
    const ends = [joint.low[second], joint.high[second]].map((end) => alongWall(first, onWall(second, end)));
    const along = (Math.max(joint.low[first], Math.min(...ends)) + Math.min(joint.high[first], Math.max(...ends))) / 2;
    const start = onWall(first, along), at = joint.frame[second];
    const cosine = dot(other, across), sine = dot(other, [-across[1], across[0]]);
    const reach = dot(other, [at[0] - start[0], at[1] - start[1]]) / cosine;
    const end = [start[0] + reach * across[0], start[1] + reach * across[1]];
    const turn = (reach * sine) / 2; // the bisector turns with the walls
    const gradient = [
      [2 * second, 1], [2 * second + 1, alongWall(second, end) - turn],
      [2 * first, -dot(other, one)], [2 * first + 1, -dot(other, one) * along - turn],
    ].map(([value, slope]) => [value, slope / cosine]);
    return [Math.abs(reach), deviation(gradient)];
  };
  const measure = (first, second) => {
    const turn = joint.frame[second][2] - joint.frame[first][2];
    const angle = Math.abs(Math.atan2(Math.sin(turn), Math.cos(turn)));
    const sigma = deviation([[2 * first + 1, -1], [2 * second + 1, 1]]);
    const degrees = (radians) => `${((radians * 180) / Math.PI).toFixed(2)}°`;
    let text = `walls ${joint.identity[first]} and ${joint.identity[second]}: `;
    if (Math.abs(Math.sin(turn)) <= joint.minSine) {
      const [metres, error] = distance(first, second);
      text += `distance ${metres.toFixed(4)} m, standard deviation ${(1e3 * error).toFixed(1)} mm; `;
    }
    return `${text}angle ${degrees(angle)}, standard deviation ${degrees(sigma)}`;
  };

  // Describe the element nearest to a click or touch
  const choose = (element) => {
    for (const old of svg.querySelectorAll(".chosen")) old.classList.remove("chosen");
    element.classList.add("chosen");
    about.textContent = element.querySelector("title").textContent;
    svg.dispatchEvent(new CustomEvent("chosen", { detail: element }));
    if (!joint || !element.dataset.wall) return;
    const wall = joint.identity.indexOf(Number(element.dataset.wall));
    if (wall >= 0 && chosenWall >= 0 && wall !== chosenWall) {
      about.textContent = measure(chosenWall, wall);
      svg.querySelector(`.walls [data-wall="${joint.identity[chosenWall]}"]`)?.classList.add("chosen");
    }
    chosenWall = wall;
  };
  svg.addEventListener("click", (event) => {
    if (dragged > 4) return;
    for (const reach of [0, 4, 8, 12, 16]) {
      for (let turn = 0; turn < (reach ? 12 : 1); turn++) {
        const angle = (turn * Math.PI) / 6;
        const x = event.clientX + reach * Math.cos(angle), y = event.clientY + reach * Math.sin(angle);
        const near = document.elementsFromPoint(x, y).find((one) => svg.contains(one) && one.querySelector("title"));
        if (near && near !== svg && near.tagName !== "g") return choose(near);
      }
    }
  });

  // The time slider: the path driven up to a time, the loops decided by then, and the robot
  const slider = document.querySelector(".time input"), clock = document.querySelector(".time output");
  const robot = svg.querySelector(".robot"), loops = svg.querySelectorAll(".loops [data-time]");
  const runs = [...svg.querySelectorAll(".path polyline")].map((line) => {
    const points = line.getAttribute("points").split(" ");
    return { line, points, times: line.dataset.times.split(" ").map(Number) };
  });
  const setTime = (seconds) => {
    slider.value = seconds;
    const time = Number(slider.value), ended = time >= Number(slider.max);
    let last = runs[0]?.points[0];
    for (const { line, points, times } of runs) {
      const count = ended ? points.length : times.filter((one) => one <= time).length;
      line.setAttribute("points", points.slice(0, count).join(" "));
      if (count) last = points[count - 1];
    }
    for (const loop of loops) loop.style.visibility = ended || Number(loop.dataset.time) <= time ? "" : "hidden";
    robot.setAttribute("visibility", ended || !last ? "hidden" : "visible");
    if (last) [robot.cx.baseVal.value, robot.cy.baseVal.value] = last.split(",").map(Number);
    clock.textContent = `${Math.floor(time / 60)}:${String(Math.floor(time % 60)).padStart(2, "0")}`;
  };
  slider.addEventListener("input", () => setTime(slider.value));
  setTime(slider.max);

  // The layer of the confidence map
  const layer = document.querySelector(".layer input");
  const setConfidence = (shown) => {
    layer.checked = shown;
    svg.classList.toggle("confident", shown);
  };
  layer?.addEventListener("change", () => setConfidence(layer.checked));

  /** Show the map around a point, `size` metres wide, or all of it if that is less. */
  const showAround = (x, y, size) => {
    const share = Math.max(0.25, Math.min(1, size / all.width));
    view = { x: 0, y: 0, width: all.width * share, height: all.height * share };
    view.x = x - view.width / 2;
    view.y = y - view.height / 2;
    clampView();
    show();
    svg.scrollIntoView({ block: "center", behavior: "smooth" });
  };

  // A loop decision in the table, and the picture of a doubt, show their place on the map
  for (const row of document.querySelectorAll("tr[data-loop]")) {
    const showLoop = () => {
      const mark = svg.querySelector(`.loops [data-loop="${CSS.escape(row.dataset.loop)}"]`);
      if (!mark) return;
      setTime(mark.dataset.time);
      choose(mark);
      const box = mark.getBBox();
      showAround(box.x + box.width / 2, box.y + box.height / 2, 3 * Math.max(box.width, box.height));
    };
    row.addEventListener("click", showLoop);
    row.addEventListener("keydown", (event) => {
      if (event.key !== "Enter" && event.key !== " ") return;
      event.preventDefault();
      showLoop();
    });
  }
  for (const place of document.querySelectorAll(".place")) {
    place.addEventListener("click", () => {
      if (place.closest("#confidence")) setConfidence(true);
      setTime(place.dataset.time);
      showAround(Number(place.dataset.x), Number(place.dataset.y), 0);
    });
  }

  window.addEventListener("resize", show);
  show();
})();
