// A list with one choice, inside the page: the browser's own list covers the page (all of it on a phone) and takes Esc.
//
// Used like a `select`: `value`, `disabled`, and an event `change` when a user has chosen.

import { $, element, set } from "./dom.js";

const ROOM = 8;
const TALL = 380;
let number = 0;

class Choice extends HTMLElement {
  #options = [];
  #value = "";
  #typed = "";

  connectedCallback() {
    if (this.button) return;
    const given = [...this.querySelectorAll("data")].map((item) => [item.value, item.textContent]);
    const id = `choice-${(number += 1)}`;
    this.list = element("ul", { id, role: "listbox", tabIndex: -1, hidden: true, ariaLabel: this.getAttribute("label") ?? "" });
    this.button = element("button", { type: "button", role: "combobox", ariaHasPopup: "listbox", ariaExpanded: "false", ariaLabel: this.getAttribute("label") ?? "" });
    this.button.setAttribute("aria-controls", id);
    this.replaceChildren(this.button, this.list);
    this.button.addEventListener("click", () => this.open(this.list.hidden));
    this.addEventListener("keydown", (event) => this.#key(event));
    this.list.addEventListener("click", (event) => {
      const item = event.target.closest("li");
      if (item) this.#choose(item.dataset.value);
    });
    const away = (event) => this.contains(event.target) || this.open(false);
    document.addEventListener("pointerdown", away, true);
    document.addEventListener("focusin", away);
    // Scrolling moves the button but not the list, so the list closes.
    addEventListener("scroll", (event) => event.target !== this.list && event.target.contains(this) && this.open(false), true);
    addEventListener("resize", () => this.open(false));
    this.options = given;
    this.value = this.getAttribute("value") ?? given[0]?.[0] ?? "";
  }

  // Pairs of value and text.
  set options(pairs) {
    this.#options = pairs.map(([value, words]) => [String(value), words]);
    this.list.replaceChildren(...this.#options.map(([value, words]) => element("li", { id: `${this.list.id}-${value}`, role: "option", data: { value } }, words)));
    this.#show();
  }

  get options() {
    return this.#options;
  }

  get value() {
    return this.#value;
  }

  set value(value) {
    this.#value = String(value);
    this.#show();
  }

  get disabled() {
    return this.button.disabled;
  }

  set disabled(disabled) {
    set(this.button, { disabled });
    if (disabled) this.open(false);
  }

  open(opened) {
    if (opened === !this.list.hidden) return;
    this.list.hidden = !opened;
    this.button.ariaExpanded = String(opened);
    if (!opened) return;
    const at = this.button.getBoundingClientRect();
    // On a phone STOP lies at the lower edge, above everything: a finger that chooses something must not press it.
    const stop = $("stop").getBoundingClientRect().top;
    const floor = stop > innerHeight / 2 ? stop : innerHeight;
    const [below, above] = [floor - at.bottom - ROOM, Math.min(at.top, floor) - ROOM];
    const { style } = this.list;
    const tall = Math.min(this.list.scrollHeight + 2, TALL);
    const down = below >= tall || below >= above;
    style.maxHeight = `${Math.min(TALL, down ? below : above) - 4}px`;
    style.minWidth = `${at.width}px`;
    style.left = `${Math.max(ROOM, Math.min(at.left, innerWidth - this.list.offsetWidth - ROOM))}px`;
    style.top = down ? `${at.bottom + 4}px` : "auto";
    style.bottom = down ? "auto" : `${innerHeight - Math.min(at.top, floor) + 4}px`;
    this.list.querySelector("[aria-selected=true]")?.scrollIntoView({ block: "nearest" });
  }

  #show() {
    const words = this.#options.find(([value]) => value === this.#value)?.[1] ?? "";
    if (this.button.textContent !== words) this.button.textContent = words;
    for (const item of this.list.children) item.ariaSelected = String(item.dataset.value === this.#value);
    this.button.setAttribute("aria-activedescendant", `${this.list.id}-${this.#value}`);
  }

  #choose(value) {
    this.open(false);
    this.button.focus();
    this.#take(value);
  }

  #take(value) {
    if (value === this.#value) return;
    this.value = value;
    this.dispatchEvent(new Event("change", { bubbles: true }));
  }

  #key(event) {
    const at = this.#options.findIndex(([value]) => value === this.#value);
    const last = this.#options.length - 1;
    const steps = { ArrowDown: at + 1, ArrowUp: at - 1, Home: 0, End: last };
    if (event.key in steps) {
      const step = Math.max(0, Math.min(last, steps[event.key]));
      if (last >= 0) this.#take(this.#options[step][0]);
      this.list.querySelector("[aria-selected=true]")?.scrollIntoView({ block: "nearest" });
    } else if (event.key === "Escape") {
      this.open(false);
      return;
    } else if (event.key.length === 1 && event.key !== " " && !event.ctrlKey && !event.metaKey && !event.altKey) {
      this.#search(event.key);
    } else {
      return;
    }
    event.preventDefault();
    event.stopPropagation();
  }

  // Selects the option that begins with the letters typed in sequence.
  #search(letter) {
    clearTimeout(this.typing);
    this.typing = setTimeout(() => (this.#typed = ""), 700);
    this.#typed += letter.toLowerCase();
    const found = this.#options.find(([, words]) => words.toLowerCase().startsWith(this.#typed));
    if (found) this.#take(found[0]);
  }
}

customElements.define("choice-list", Choice);

// Creates a list from a script.
export function choice(label, pairs) {
  const made = element("choice-list", { label });
  made.connectedCallback();
  made.options = pairs;
  made.value = pairs[0]?.[0] ?? "";
  return made;
}
