// The panels around the net: each can be folded and resized, by pointer and by keys, and this browser remembers it.
// The page has three layouts: wide (all panels at once), medium (the list or the details), narrow (one panel, below the
// net).

import { $ } from "./dom.js";

const KEPT = "gspn-panels";
const PANELS = ["left", "right", "bottom"];
const [NARROW, MEDIUM] = [640, 1000]; // px: below the first a page is narrow, below the second medium; as in panels.css
const STEP = 24; // px that a key moves a separator
const CENTRE = 280; // px reserved for the net
const LOG = [180, 240]; // least width in px of the log, and of the time line beside it

const between = (low, value, high) =>
  Math.round(Math.max(low, Math.min(Math.max(low, high), value)));

/** The default size of each part. */
const DEFAULT = {
  left: (width) => between(190, width * 0.16, 300),
  right: (width) => between(312, width * 0.242, 560),
  bottom: (width, height) => between(128, height * 0.21, 260),
  log: (width) => between(220, width * 0.242, 560),
  under: (width, height) => between(150, height * 0.42, 420),
};

const OPEN = { wide: ["left", "right", "bottom"], medium: ["right", "bottom"], narrow: [] };

export class Panels {
  /** `changed` is called when the sizes of the page's parts have changed. */
  constructor(changed = () => {}) {
    this.changed = changed;
    this.kept = read();
    this.page = $("page");
    this.separators = {
      left: $("split-left"),
      right: $("split-right"),
      bottom: $("split-bottom"),
      log: $("split-log"),
    };
    for (const [part, separator] of Object.entries(this.separators)) this.bind(part, separator);
    for (const panel of PANELS) $(`fold-${panel}`).onclick = () => this.toggle(panel);
    $("widen").onclick = () => this.widen();
    new ResizeObserver(() => this.apply()).observe(this.page); // also runs when it is first shown
    this.apply();
  }

  get form() {
    return innerWidth < NARROW ? "narrow" : innerWidth < MEDIUM ? "medium" : "wide";
  }

  /** The stored state of the current form: {open: [panel, ...], sizes: {part: px}, grown}. */
  get state() {
    const { form } = this;
    if (!this.kept[form]) this.kept[form] = { open: [...OPEN[form]], sizes: {}, grown: false };
    return this.kept[form];
  }

  isOpen(panel) {
    return this.state.open.includes(panel);
  }

  /** Unfold a panel; if there is no room for two, the other one is folded. */
  open(panel) {
    if (this.isOpen(panel)) return;
    const others = {
      wide: [],
      medium: panel === "bottom" ? [] : ["left", "right"],
      narrow: PANELS,
    }[this.form];
    this.state.open = [...this.state.open.filter((other) => !others.includes(other)), panel];
    this.done();
  }

  fold(panel) {
    if (!this.isOpen(panel)) return;
    const inside = $(panel).contains(document.activeElement);
    this.state.open = this.state.open.filter((other) => other !== panel);
    this.done();
    if (inside) $(`fold-${panel}`).focus();
  }

  toggle(panel) {
    if (this.isOpen(panel)) this.fold(panel);
    else this.open(panel);
  }

  /** Give the details half of the page, for an analysis, or undo this. */
  widen() {
    this.state.grown = !this.state.grown;
    this.done();
  }

  /** The part that a separator resizes: in a narrow page the one below the net sets the height of the open panel. */
  part(separator) {
    return separator === "bottom" && this.form === "narrow" ? "under" : separator;
  }

  /** Smallest and largest size of a part, in px. */
  limits(part) {
    const { width, height } = this.page.getBoundingClientRect();
    const used = (panel) =>
      this.form !== "narrow" && this.isOpen(panel) ? this.size(panel, width, height) : 0;
    switch (part) {
      case "left":
        return [150, width - CENTRE - used("right")];
      case "right":
        return [240, width - CENTRE - (this.isOpen("left") ? 150 : 0)];
      case "log":
        return [LOG[0], width - LOG[1]];
      case "bottom":
        return [96, height * 0.6];
      default:
        return [110, height * 0.8];
    }
  }

  size(part, width, height) {
    const { sizes, grown } = this.state;
    if (grown && part === "right") return width * 0.5;
    if (grown && part === "under") return height * 0.8;
    return sizes[part] ?? DEFAULT[part](width, height);
  }

  apply() {
    const { form, state } = this;
    const { width, height } = this.page.getBoundingClientRect();
    document.body.dataset.form = form;
    for (const panel of PANELS) {
      const open = state.open.includes(panel);
      $(panel).classList.toggle("folded", !open);
      $(`fold-${panel}`).setAttribute("aria-expanded", open);
    }
    this.separators.left.hidden = form === "narrow" || !this.isOpen("left");
    this.separators.right.hidden = form === "narrow" || !this.isOpen("right");
    this.separators.bottom.hidden = !(form === "narrow"
      ? state.open.length
      : this.isOpen("bottom"));
    this.separators.log.hidden = form === "narrow" || !this.isOpen("bottom");
    $("widen").setAttribute("aria-pressed", state.grown);
    if (!width || !height) return;
    for (const part of ["right", "left", "bottom", "log", "under"]) {
      const [low, high] = this.limits(part);
      const size = between(low, this.size(part, width, height), high);
      this.page.style.setProperty(`--${part}`, `${size}px`);
      const separator = this.separators[part === "under" ? "bottom" : part];
      if (this.part(part === "under" ? "bottom" : part) !== part) continue;
      separator.setAttribute("aria-valuenow", size);
      separator.setAttribute("aria-valuemin", Math.round(low));
      separator.setAttribute("aria-valuemax", Math.round(Math.max(low, high)));
      separator.setAttribute("aria-valuetext", `${size} pixels`);
    }
    this.changed();
  }

  done() {
    write(this.kept);
    this.apply();
  }

  resize(part, size) {
    const [low, high] = this.limits(part);
    this.state.sizes[part] = between(low, size, high);
    if (part === "right" || part === "under") this.state.grown = false;
    this.done();
  }

  bind(separator, element) {
    const upright = element.getAttribute("aria-orientation") === "vertical";
    const grows = separator === "left" ? 1 : -1; // the other panels grow to the left or upwards
    const now = () => Number(element.getAttribute("aria-valuenow"));
    element.onkeydown = (event) => {
      const steps = upright ? { ArrowRight: 1, ArrowLeft: -1 } : { ArrowDown: 1, ArrowUp: -1 };
      const part = this.part(separator);
      const act =
        {
          Home: () => this.resize(part, -Infinity),
          End: () => this.resize(part, Infinity),
          Enter: () => this.foldBeside(separator),
        }[event.key] ||
        (steps[event.key] && (() => this.resize(part, now() + steps[event.key] * grows * STEP)));
      if (!act) return;
      event.preventDefault();
      event.stopPropagation();
      act();
    };
    element.ondblclick = () => {
      delete this.state.sizes[this.part(separator)];
      this.state.grown = false;
      this.done();
    };
    element.onpointerdown = (event) => {
      if (event.button !== 0) return;
      event.preventDefault();
      element.focus();
      element.setPointerCapture(event.pointerId);
      const begin = upright ? event.clientX : event.clientY,
        size = now();
      element.onpointermove = (moved) =>
        this.resize(
          this.part(separator),
          size + grows * ((upright ? moved.clientX : moved.clientY) - begin),
        );
      element.onpointerup = element.onpointercancel = () => {
        element.onpointermove = null;
      };
    };
  }

  foldBeside(separator) {
    if (separator === "log") return;
    this.fold(this.form === "narrow" ? this.state.open[0] : separator);
  }
}

function read() {
  const kept = {};
  let data = null;
  try {
    data = JSON.parse(localStorage.getItem(KEPT));
  } catch {
    /* unreadable values are ignored */
  }
  for (const form of Object.keys(OPEN)) {
    const { open, sizes, grown } = data?.[form] || {};
    if (!Array.isArray(open)) continue;
    kept[form] = {
      open: PANELS.filter((panel) => open.includes(panel)).slice(
        form === "narrow"
          ? -1
          : form === "medium" && open.includes("left") && open.includes("right")
            ? -2
            : 0,
      ),
      sizes: Object.fromEntries(
        Object.keys(DEFAULT)
          .filter((part) => Number.isFinite(sizes?.[part]))
          .map((part) => [part, sizes[part]]),
      ),
      grown: Boolean(grown),
    };
  }
  return kept;
}

function write(kept) {
  try {
    localStorage.setItem(KEPT, JSON.stringify(kept));
  } catch {
    /* private browsing: kept until the page is closed */
  }
}
