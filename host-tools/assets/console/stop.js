// STOP: works before the rest of the page is loaded, and over everything that the page shows.
//
// A plain script in the head: it runs before the first picture, and needs neither the modules nor the socket. A press
// on STOP, or Esc wherever the focus is, posts a stop repeatedly until the console has accepted it. `link.js` also
// sends it over the socket, and calls `stands` when the firmware reports that the robot is stopped.

"use strict";

(() => {
  const RETRY_MS = 250;
  const POST_MAX_MS = 2000;

  // A browser that stores nothing for this page still stops the robot.
  const remembered = (token) => {
    try {
      if (token) sessionStorage.setItem("token", token);
      return sessionStorage.getItem("token") ?? "";
    } catch {
      return token ?? "";
    }
  };
  const given = new URLSearchParams(location.hash.slice(1)).get("token");
  const token = remembered(given);
  if (given) history.replaceState(null, "", location.pathname);

  const stop = Object.assign(new EventTarget(), { token, asked: false, taken: false, refused: "" });
  globalThis.etherpenStop = stop;

  const changed = () => {
    const button = document.getElementById("stop");
    button.dataset.state = stop.asked ? "asked" : "ready";
    document.getElementById("stop-text").textContent = stop.refused || (stop.taken ? "sent, not confirmed" : "sending");
    stop.dispatchEvent(new Event("change"));
  };

  let posting = false;
  const post = async () => {
    if (posting) return;
    posting = true;
    while (stop.asked && !stop.taken && !stop.refused) {
      try {
        const answer = await fetch("/stop", { method: "POST", headers: { "x-etherpen-token": token }, signal: AbortSignal.timeout(POST_MAX_MS) });
        stop.taken = answer.ok;
        stop.refused = answer.status === 403 ? "needs the address with the token" : "";
      } catch {
        stop.taken = false;
      }
      if (!stop.taken && !stop.refused) await new Promise((next) => setTimeout(next, RETRY_MS));
      changed();
    }
    if (stop.refused) stop.asked = false;
    posting = false;
  };

  stop.ask = () => {
    Object.assign(stop, { asked: true, taken: false, refused: "" });
    stop.dispatchEvent(new Event("ask"));
    changed();
    post();
  };

  // The firmware reports that the robot is stopped.
  stop.stands = () => {
    stop.asked = false;
  };

  // The press counts, not the release; a click without a press comes from the keyboard or a screen reader.
  let pressed = false;
  const meant = (event) => event.target instanceof Element && event.target.closest("#stop");
  addEventListener("pointerdown", (event) => {
    pressed = Boolean(meant(event));
    if (pressed) stop.ask();
  }, true);
  addEventListener("click", (event) => {
    if (!meant(event)) return;
    if (!pressed) stop.ask();
    pressed = false;
  }, true);
  addEventListener("keydown", (event) => {
    if (event.key !== "Escape") return;
    // Otherwise the browser stops loading the page.
    event.preventDefault();
    if (!event.repeat) stop.ask();
  }, true);

  // STOP stays inside the visible part of the page: next to an on-screen keyboard, and at any zoom.
  const seen = globalThis.visualViewport;
  const follow = () => {
    const { style } = document.documentElement;
    const [width, height] = [document.documentElement.clientWidth, document.documentElement.clientHeight];
    const hidden = { left: seen.offsetLeft, top: seen.offsetTop, right: width - seen.offsetLeft - seen.width, bottom: height - seen.offsetTop - seen.height };
    for (const [side, length] of Object.entries(hidden)) style.setProperty(`--hidden-${side}`, `${Math.max(0, length).toFixed(1)}px`);
  };
  for (const name of ["resize", "scroll"]) seen?.addEventListener(name, follow);
})();
