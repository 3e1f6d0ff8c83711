// The sheet from above: what is drawn, what is being drawn, what remains, and the measured pen.

import { $, Canvas, duration, text } from "./dom.js";

const MARGIN = 14;

export function paper(link) {
  let job = null;
  let preview = null;
  let previewed = "";
  let executed = 0;
  let painted = 0;
  let dirty = true;
  const layer = document.createElement("canvas");
  const screen = new Canvas($("paper"), () => repaint());
  const shown = () => (link.state.jobs?.active || !preview ? job : preview) ?? preview;

  // The file is being planned with other options, or planning failed.
  const isOld = () => shown() === preview && link.state.studio?.state !== "ready";

  const place = () => {
    const sheet = link.state.robot?.paper;
    if (!sheet) return null;
    const [width, height] = sheet.size_mm;
    const scale = Math.min((screen.width - 2 * MARGIN) / width, (screen.height - 2 * MARGIN) / height);
    const x = (mm) => screen.width / 2 + (mm - sheet.centre_mm[0]) * scale;
    const y = (mm) => screen.height / 2 - (mm - sheet.centre_mm[1]) * scale;
    return { scale, x, y, width: width * scale, height: height * scale, sheet };
  };

  // Strokes of a range of vertices of the path, where they are drawn.
  const trace = (context, at, path, from, to) => {
    context.beginPath();
    let down = false;
    for (let vertex = Math.max(from, 1); vertex < to; vertex += 1) {
      if (!path.drawn[vertex]) {
        down = false;
        continue;
      }
      if (!down) context.moveTo(at.x(path.x[vertex - 1]), at.y(path.y[vertex - 1]));
      context.lineTo(at.x(path.x[vertex]), at.y(path.y[vertex]));
      down = true;
    }
    context.stroke();
  };

  const vertexAfter = (path, index) => {
    let [low, high] = [0, path.index.length];
    while (low < high) {
      const middle = (low + high) >> 1;
      if (path.index[middle] < index) low = middle + 1;
      else high = middle;
    }
    return low;
  };

  const prepare = (context) => {
    context.lineCap = "round";
    context.lineJoin = "round";
    context.lineWidth = 1.1;
  };

  const repaint = () => {
    dirty = true;
    painted = 0;
    layer.width = screen.canvas.width;
    layer.height = screen.canvas.height;
    const at = place();
    const context = layer.getContext("2d");
    if (!at) return;
    context.setTransform(screen.ratio, 0, 0, screen.ratio, 0, 0);
    context.fillStyle = screen.colours.sheet;
    context.shadowColor = "rgba(0, 0, 0, 0.14)";
    context.shadowBlur = 10;
    context.fillRect(screen.width / 2 - at.width / 2, screen.height / 2 - at.height / 2, at.width, at.height);
    context.shadowBlur = 0;
    const path = shown();
    if (!path) return;
    prepare(context);
    // A preview looks as it will on paper; the ink of a drawing appears with the pen.
    context.globalAlpha = isOld() ? 0.25 : 1;
    context.strokeStyle = path === job ? screen.colours["sheet-rest"] : screen.colours["sheet-ink"];
    trace(context, at, path, 1, path.index.length);
    context.globalAlpha = 1;
  };

  const paintDone = () => {
    const path = shown();
    const at = place();
    if (!path || path !== job || !at) return;
    const until = vertexAfter(path, executed);
    if (until <= painted) return;
    const context = layer.getContext("2d");
    prepare(context);
    context.lineWidth = 1.3;
    context.strokeStyle = screen.colours["sheet-ink"];
    trace(context, at, path, painted, until);
    painted = until;
  };

  const draw = () => {
    if (dirty) {
      dirty = false;
      paintDone();
      const { context } = screen;
      const at = place();
      screen.clear();
      if (at) {
        context.setTransform(1, 0, 0, 1, 0, 0);
        context.drawImage(layer, 0, 0);
        context.setTransform(screen.ratio, 0, 0, screen.ratio, 0, 0);
        current(context, at);
        pen(context, at, screen.colours);
      }
    }
    requestAnimationFrame(draw);
  };

  const current = (context, at) => {
    const path = shown();
    if (!path || path !== job || !link.state.jobs?.active) return;
    let [from, to] = [painted, painted];
    while (from > 1 && path.drawn[from - 1]) from -= 1;
    while (to < path.index.length && path.drawn[to]) to += 1;
    prepare(context);
    context.lineWidth = 2.2;
    context.strokeStyle = screen.colours["sheet-accent"];
    trace(context, at, path, from, to);
  };

  const pen = (context, at, colours) => {
    const pose = link.state.pose;
    if (!pose || !Number.isFinite(pose.measured_mm[0]) || link.state.status?.referenced === false) return;
    const clamp = (value, low, high) => Math.min(high, Math.max(low, value));
    const [x, y] = [clamp(at.x(pose.measured_mm[0]), 6, screen.width - 6), clamp(at.y(pose.measured_mm[1]), 6, screen.height - 6)];
    const lowered = isLowered(at.sheet, pose.measured_mm);
    context.beginPath();
    context.arc(x, y, lowered ? 4.5 : 7, 0, 7);
    context.lineWidth = 2;
    const known = link.silentSeconds() < 1;
    context.strokeStyle = context.fillStyle = known ? colours["sheet-accent"] : colours["sheet-edge"];
    context.setLineDash(known ? [] : [2, 3]);
    if (lowered && known) context.fill();
    context.stroke();
    context.setLineDash([]);
  };

  const facts = () => {
    const { jobs, progress, studio } = link.state;
    if (jobs?.active) {
      const { name } = jobs.active;
      text($("paper-name"), `${name} · ${jobs.phase || "starting"}`);
      const current = progress?.job === jobs.active.number ? progress : null;
      text($("paper-time"), current ? `${current.strokes} of ${current.strokes_total} strokes · ${duration(current.left_s)} left` : `planned ${duration(jobs.active.planned_s)}`);
      $("paper-progress").value = current ? current.executed_mm / Math.max(current.total_mm, 1) : 0;
    } else if (preview && studio?.state === "working") {
      text($("paper-name"), `${studio.name} · being planned again`);
      text($("paper-time"), "");
      $("paper-progress").value = 0;
    } else if (preview && studio?.state === "ready") {
      text($("paper-name"), `${studio.name} · preview`);
      text($("paper-time"), `planned ${duration(studio.planned_s)}`);
      $("paper-progress").value = 0;
    } else {
      const last = jobs?.past[0];
      text($("paper-name"), last ? `${last.name} · ${last.done ? "done" : "ended early"}` : "no drawing yet");
      text($("paper-time"), last ? `drawn in ${duration(last.drawn_s)}` : "");
    }
  };

  link.on("path", (path) => {
    if (path.use === 1) [job, executed] = [path, 0];
    else [preview, previewed] = [path, link.state.studio?.name];
    facts();
    repaint();
  });
  link.on("studio", (studio) => {
    // The preview of the same file stays, dimmed, until the next one arrives.
    if (!studio || studio.state === "idle" || (preview && studio.name !== previewed)) preview = null;
    facts();
    repaint();
  });
  link.on("jobs", (jobs) => {
    if (jobs?.active) preview = null;
    facts();
    repaint();
  });
  link.on("progress", (progress) => {
    if (progress && job && progress.job === job.number) executed = Math.max(executed, progress.executed);
    dirty = true;
    facts();
  });
  link.on("pose", () => (dirty = true));
  link.on("robot", repaint);
  facts();
  requestAnimationFrame(draw);
}

// Whether a tool is nearer to its drawing height than to its lifted height above the sheet, which need not lie level.
export function isLowered({ centre_mm: [x, y], slope: [alongX, alongY], pen_down_z_mm: down, pen_lift_mm: lift }, tool) {
  return tool[2] - alongX * (tool[0] - x) - alongY * (tool[1] - y) <= down + lift / 2;
}
