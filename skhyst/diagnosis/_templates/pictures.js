"use strict";
// Values on hover, zoom by dragging a rectangle, and back by a double click. A picture's axes carry
// [left, top, width, height in the picture, values at the left, right, bottom and top, names, logs].
for (const svg of document.querySelectorAll("figure svg")) {
  const panels = [...svg.querySelectorAll("[data-axes]")];
  const whole = svg.getAttribute("viewBox");
  const label = document.createElement("div");
  label.className = "value";
  label.hidden = true;
  svg.parentNode.append(label);
  let start = null;
  const at = (event) =>
    new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
  const between = (low, high, part, log) =>
    log ? low * (high / low) ** part : low + (high - low) * part;
  svg.addEventListener("pointermove", (event) => {
    const p = at(event);
    label.hidden = true;
    for (const panel of panels) {
      const [left, top, width, height, x0, x1, y0, y1, xName, yName, xLog, yLog] = JSON.parse(panel.dataset.axes);
      const u = (p.x - left) / width, v = 1 - (p.y - top) / height;
      if (u < 0 || u > 1 || v < 0 || v > 1) continue;
      const x = between(x0, x1, u, xLog), y = between(y0, y1, v, yLog);
      label.textContent = `${xName || "x"}: ${x.toPrecision(4)}\n${yName || "y"}: ${y.toPrecision(4)}`;
      const box = svg.parentNode.getBoundingClientRect();
      const far = event.clientX - box.left > box.width / 2;
      label.hidden = false;
      label.style.left = `${svg.parentNode.scrollLeft + event.clientX - box.left + (far ? -14 - label.offsetWidth : 14)}px`;
      label.style.top = `${event.clientY - box.top + 14}px`;
    }
  });
  svg.addEventListener("pointerleave", () => { label.hidden = true; });
  svg.addEventListener("pointerdown", (event) => { start = at(event); });
  svg.addEventListener("pointerup", (event) => {
    if (start === null) return;
    const end = at(event), width = Math.abs(end.x - start.x), height = Math.abs(end.y - start.y);
    if (width > 8 && height > 8) {
      svg.setAttribute("viewBox", `${Math.min(start.x, end.x)} ${Math.min(start.y, end.y)} ${width} ${height}`);
    }
    start = null;
  });
  svg.addEventListener("dblclick", () => { svg.setAttribute("viewBox", whole); });
}
