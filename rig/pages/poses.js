"use strict";
// Poses in 3D: drag, or use the arrow keys, to rotate the view; double-click to reset it; point at a pose to read
// its position. Without this program the page shows one fixed view of the same poses.
(() => {
  const colour = name => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

  function show(place) {
    const {groups, low, high, step, view: first} = JSON.parse(place.querySelector("script").textContent);
    const canvas = document.createElement("canvas"), about = document.createElement("p");
    let [turned, tilted] = first, held = null, pointed = null;  // rad
    const middle = low.map((v, i) => (v + high[i]) / 2), radius = Math.hypot(...low.map((v, i) => high[i] - v)) / 2;
    canvas.tabIndex = 0;
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", place.querySelector("svg").getAttribute("aria-label"));
    about.className = "small";
    place.querySelector("svg").replaceWith(canvas, about);

    function flat([x, y, z]) {
      const [a, b, c] = [x - middle[0], y - middle[1], z - middle[2]];
      const across = a * Math.cos(turned) - b * Math.sin(turned);
      const deep = a * Math.sin(turned) + b * Math.cos(turned);
      const up = c * Math.cos(tilted) + deep * Math.sin(tilted);
      const size = 0.42 * canvas.clientWidth / radius;
      return [canvas.clientWidth / 2 + size * across, canvas.clientHeight / 2 - size * up];
    }

    function draw() {
      const width = canvas.clientWidth, height = canvas.clientHeight, ctx = canvas.getContext("2d");
      [canvas.width, canvas.height] = [width * devicePixelRatio, height * devicePixelRatio];
      ctx.scale(devicePixelRatio, devicePixelRatio);
      ctx.font = "13px sans-serif";
      const line = (from, to) => {
        ctx.beginPath(); ctx.moveTo(...flat(from)); ctx.lineTo(...flat(to)); ctx.stroke();
      };
      ctx.strokeStyle = colour("line");
      for (let x = low[0]; x <= high[0] + step / 2; x += step) line([x, low[1], low[2]], [x, high[1], low[2]]);
      for (let y = low[1]; y <= high[1] + step / 2; y += step) line([low[0], y, low[2]], [high[0], y, low[2]]);
      ctx.strokeStyle = ctx.fillStyle = colour("ink");
      ["x", "y", "z"].forEach((name, axis) => {
        const end = [...low];
        end[axis] += step;
        line(low, end);
        ctx.fillText(name, flat(end)[0] + 4, flat(end)[1] + 4);
      });
      groups.forEach(group => {
        ctx.strokeStyle = ctx.fillStyle = colour(group.colour);
        group.poses.forEach(({at, ends}) => {
          ends.forEach(end => line(at, end));
          ctx.beginPath(); ctx.arc(...flat(at), 3, 0, 7); ctx.fill();
        });
      });
      if (!pointed) return;
      ctx.strokeStyle = colour("ink");
      ctx.beginPath(); ctx.arc(...flat(pointed.at), 7, 0, 7); ctx.stroke();
    }

    function describe() {
      about.textContent = pointed
        ? `${pointed.name}: x ${number(pointed.at[0], 3)}, y ${number(pointed.at[1], 3)}, z ${number(pointed.at[2], 3, " m")}`
        : `Grid: ${step} m. Drag, or use the arrow keys, to rotate; point at a pose to read its position.`;
    }

    function turn(across, up) {
      turned -= across;
      tilted = Math.min(Math.max(tilted + up, -1.57), 1.57);
      draw();
    }

    function nearest(event) {
      const all = groups.flatMap(group => group.poses.map(pose => ({name: group.name, ...pose})));
      const away = ({at}) => Math.hypot(flat(at)[0] - event.offsetX, flat(at)[1] - event.offsetY);
      const found = all.reduce((best, pose) => away(pose) < away(best) ? pose : best);
      return away(found) < 12 ? found : null;
    }

    canvas.onpointerdown = event => { held = event; canvas.setPointerCapture(event.pointerId); };
    canvas.onpointerup = canvas.onpointercancel = () => { held = null; };
    canvas.onpointermove = event => {
      if (held) {
        turn(0.01 * (event.clientX - held.clientX), 0.01 * (event.clientY - held.clientY));
        held = event;
      } else { pointed = nearest(event); describe(); draw(); }
    };
    canvas.ondblclick = () => { [turned, tilted] = first; draw(); };
    canvas.onkeydown = event => {
      const by = {ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1]}[event.key];
      if (by) { turn(...by); event.preventDefault(); }
    };
    new ResizeObserver(draw).observe(canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
    describe();
  }

  document.querySelectorAll(".poses").forEach(show);
})();
