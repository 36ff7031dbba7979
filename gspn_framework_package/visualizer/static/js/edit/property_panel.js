// The panel of the selection: a place, a transition, an arc or several of them, with everything the plan says about
// them.

import { h, natural, plural } from "../dom.js";
import { get } from "../api.js";
import { FormPanel, Lens, MIXED } from "./form.js";
import { NAMES } from "./names.js";
import { arcKey, changeArcs, changeNodes, changed, nodeKey, otherKind } from "./net_edits.js";
import { HINTS } from "./plan_hints.js";
import { problemOfName, renamed } from "./rename.js";
import { addRobot, robotRow, robotsLens, robotsOf } from "./robots_form.js";
import { numbersIn, planSchema, problemOf } from "./schema.js";
import { schemaField, wordOf } from "./schema_form.js";

/** Shared by all forms of plans: the schema, and the palette of existing actions. */
export class PlanForm extends FormPanel {
  constructor(mode, name, title) {
    super(mode, name, title);
    this.schema = null;
    this.hints = HINTS;
    this.palette = null;
    this.load();
  }

  async load() {
    try {
      this.schema = await planSchema();
    } catch (error) {
      this.element.replaceChildren(h("p.wrong", { role: "alert", text: error.message }));
      return;
    }
    this.refresh();
    const take = (palette) => {
      this.palette = palette;
      this.refresh();
    };
    paletteOf(this.mode).follow(take);
  }

  draw() {
    if (this.schema) super.draw();
  }

  /** The schema of a key of the plan. */
  part(key) {
    return this.schema.properties[key];
  }
}

const LOOK_AGAIN = 4000; // ms after which the palette is fetched again, since users write functions meanwhile

/** The actions that a plan can choose from, for all panels of a mode. */
class Palette {
  constructor(mode) {
    this.mode = mode;
    this.reported = []; // callbacks for the next answer
    this.text = ""; // the last answer
    this.look();
    const again = () => !document.hidden && this.look();
    const timer = setInterval(again, LOOK_AGAIN);
    addEventListener("focus", again, { signal: mode.bound.signal });
    mode.addEventListener("functions", () => this.look());
    mode.bound.signal.addEventListener("abort", () => clearInterval(timer));
  }

  /** Pass the palette to `take`, now and whenever it changes. */
  follow(take) {
    this.reported.push(take);
    if (this.text) take(JSON.parse(this.text));
  }

  async look() {
    if (this.looking) return;
    this.looking = true;
    const { mode } = this;
    const found = await get("edit/palette", mode.id ? { id: mode.id } : {}).catch(() => null);
    this.looking = false;
    const text = found && JSON.stringify(found);
    if (!text || text === this.text || mode.closed) return;
    this.text = text;
    for (const take of this.reported) take(JSON.parse(text));
  }
}

const palettes = new WeakMap(); // shared by all panels of a mode

function paletteOf(mode) {
  if (!palettes.has(mode)) palettes.set(mode, new Palette(mode));
  return palettes.get(mode);
}

const LISTS = { place: "places", transition: "transitions", arc: "arcs" };
const keyOf = {
  place: (it) => nodeKey("place", it.name),
  transition: (it) => nodeKey("transition", it.name),
  arc: arcKey,
};

export class PropertyPanel extends PlanForm {
  constructor(mode) {
    super(mode, "properties", "Properties");
    this.listen(mode, "select");
    this.listen(mode, "functions");
  }

  concerns() {
    return true; // this panel shows positions too
  }

  /** The selected elements of a kind, as in the net. */
  selected(kind) {
    const { selection } = this.mode;
    return this.document.net[LISTS[kind]].filter((it) => selection.has(keyOf[kind](it)));
  }

  content() {
    const found = Object.keys(LISTS).map((kind) => [kind, this.selected(kind)]);
    const several = found.filter(([, list]) => list.length);
    if (!several.length)
      return h(
        "p.muted",
        "Select a place, a transition or an arc to see and change what the plan says about it.",
      );
    const [[kind, list]] = several;
    if (several.length === 1 && list.length === 1) {
      const { name } = list[0];
      return kind === "place"
        ? this.place(name)
        : kind === "transition"
          ? this.transition(name)
          : this.arc(list);
    }
    return [
      h("h2", several.map(([it, { length }]) => plural(length, it)).join(", ")),
      several.map(([it, { length }]) =>
        h("fieldset", h("legend", plural(length, it)), this[`${it}Fields`](this.selected(it))),
      ),
    ];
  }

  /** A lens at a key of some nodes or arcs; `absent`: the default, which is not written. */
  net(kind, list, key, absent) {
    const wanted = new Set(list.map(keyOf[kind]));
    const name = list.length === 1 ? keyOf[kind](list[0]) : kind;
    return new Lens(
      `net.${name}.${key}`,
      () => {
        const values = new Set(
          this.document.net[LISTS[kind]]
            .filter((it) => wanted.has(keyOf[kind](it)))
            .map((it) => (it[key] === undefined ? absent : it[key])),
        );
        return values.size === 1 ? [...values][0] : values.size ? MIXED : undefined;
      },
      (value, label, merge) =>
        this.document.edit(
          label,
          ({ net }) => ({
            net: (kind === "arc" ? changeArcs : changeNodes)(net, wanted, (it) =>
              it[key] !== value && (value !== absent || it[key] !== undefined)
                ? changed(it, { [key]: value === absent ? undefined : value })
                : it,
            ),
          }),
          merge,
        ),
    );
  }

  /** A number of the net, checked against the schema. */
  netNumber(kind, list, key, absent, title) {
    const part = this.schema.definitions.net.properties[LISTS[kind]].items.properties[key];
    const who = list.length === 1 && kind !== "arc" ? ` of ${list[0].name}` : "";
    return this.labelled(
      title,
      this.number(this.net(kind, list, key, absent), `${title.toLowerCase()}${who}`, {
        whole: [part.type].flat().includes("integer"),
        formula: [part.type].flat().includes("string"),
        check: (value) => problemOf(part, value, this.schema),
        blank: { value: absent },
        placeholder: absent === null ? "unlimited" : undefined,
      }),
      part.description,
    );
  }

  name(kind, name) {
    const lens = new Lens(
      `net.${kind}:${name}.name`,
      () => name,
      (to) => {
        const done = this.document.edit(`Rename ${name} to ${to}`, (state) =>
          renamed(state, kind, name, to),
        );
        this.wanted = `net.${kind}:${to}.name`;
        this.mode.choose([`${kind}:${to}`]);
        if (kind === "transition" && this.mayBeNamed(to))
          this.mode.say(`Functions that return '${name}' must return '${to}' now.`);
        return done;
      },
    );
    return this.labelled(
      "Name",
      this.text(lens, "name", {
        late: true,
        parse: (text) => problemOfName(this.state, text, name) || [text],
      }),
    );
  }

  /** Whether a function may return the name of this transition. */
  mayBeNamed(transition) {
    const { net, plan } = this.document;
    return net.arcs.some(({ from, to }) => {
      const action = to === transition && plan.actions?.[from];
      return typeof action === "string" || action?.function;
    });
  }

  // -- places ----------------------------------------------------------------------------------------

  placeFields(list) {
    return [
      this.netNumber("place", list, "tokens", 0, "Tokens"),
      this.netNumber("place", list, "capacity", null, "Capacity"),
      this.labelled("Kind", this.placeKind(list)),
    ];
  }

  placeKind(list) {
    const names = list.map(({ name }) => name);
    const kind = ({ plan }, name) =>
      plan.resource_places?.includes(name)
        ? "resource"
        : name in (plan.actions ?? {})
          ? "action"
          : "open";
    const lens = new Lens(
      `kind.${names.length === 1 ? names[0] : "places"}`,
      () => {
        const kinds = new Set(names.map((name) => kind(this.state, name)));
        return kinds.size === 1 ? [...kinds][0] : MIXED;
      },
      (value, label) =>
        this.document.edit(label, (state) => ({ plan: withKind(state.plan, names, value) })),
    );
    const options = [
      ["action", "action place (robots)"],
      ["resource", "resource place (counters)"],
    ];
    if (lens.get() === "open") options.unshift(["open", "place of robots, no action"]);
    return this.choice(lens, "kind", options, { what: `the kind of ${names.join(", ")}` });
  }

  position(kind, name) {
    const list = this.document.net[LISTS[kind]].filter((it) => it.name === name);
    return this.drawn(kind, list, "position", "x y", (pairs) =>
      pairs.length === 1 ? pairs[0] : null,
    );
  }

  /** A field for a point, or points, of the drawing. `valueOf(pairs)`: what the pairs of numbers in it mean. */
  drawn(kind, list, key, placeholder, valueOf) {
    const lens = this.net(kind, list, key, null);
    return this.labelled(
      key[0].toUpperCase() + key.slice(1),
      this.text(lens, `${key} of ${keyOf[kind](list[0]).replace(/^[a-z]+:/, "")}`, {
        late: true,
        placeholder,
        show: (value) => (value ?? []).flat().join(" "),
        parse: (text) => {
          const { values, problem } = numbersIn(text);
          const pairs = values.flatMap((x, n) => (n % 2 ? [] : [values.slice(n, n + 2)]));
          if (!values.length) return [null];
          const value = problem || values.length % 2 ? null : valueOf(pairs);
          return value ? [value] : `numbers are needed: ${placeholder}`;
        },
      }),
    );
  }

  place(name) {
    const { plan } = this.document;
    const list = this.selected("place");
    const resource = plan.resource_places?.includes(name);
    return [
      h("h2", name),
      this.name("place", name),
      this.placeFields(list),
      this.position("place", name),
      resource
        ? this.inList("tasks.queues", ["tasks", "queues"], name, "Its tokens are tasks (a queue)")
        : [
            this.section("place action", "Action", true, () =>
              this.entry("actions", name, "Action"),
            ),
            this.section("place robots", "Robots that start here", false, () => this.robots(name)),
            this.section("place failure", "When it fails or takes long", false, () =>
              ["on_failure", "timeout", "on_evict"].map((key) => this.entry(key, name)),
            ),
            this.section("place times", "Durations, outcomes, failures", false, () => [
              ["durations", "outcomes", "failures"].map((key) => this.entry(key, name)),
              this.inList("chance", ["chance"], name, "Nobody chooses here (chance)"),
              this.inList("spawn", ["spawn"], name, "Robots of a larger team start here"),
            ]),
          ],
    ];
  }

  robots(place) {
    const lens = robotsLens(this);
    const robots = robotsOf(this.state);
    const places = NAMES.actionPlaces(this.state);
    const here = robots.map((robot, i) => [robot, i]).filter(([robot]) => robot.place === place);
    return [
      here.length
        ? here.map(([robot, i]) => robotRow(this, lens, robot, i, places))
        : h("p.muted", "none"),
      this.button("plan.robots add", "Add a robot here", () => addRobot(this, place)),
    ];
  }

  /** The form of a key of the plan for one node, or a button that adds an entry. */
  entry(key, name, title = wordOf(key)) {
    const lens = this.plan(key).at(name, { given: true });
    const part = this.part(key).additionalProperties;
    const hint = HINTS[`plan.${key}`] ?? {};
    const there = lens.get() !== undefined || this.drafts.has(lens.key);
    if (!there)
      return h(
        "div.absent",
        h("span.muted", title),
        this.button(
          `${lens.key} add`,
          "Add",
          () => {
            this.wanted = `${lens.key} remove`;
            this.put(
              lens,
              hint.start ? hint.start(this.state, name) : {},
              `Add ${title} of '${name}'`,
            );
          },
          { "aria-label": `Add: ${title}` },
        ),
      );
    return h(
      "fieldset.present",
      h("legend", { text: title, class: key === "actions" ? "unseen" : "" }),
      schemaField(this, part, lens, title, {}, true),
      this.button(
        `${lens.key} remove`,
        "Remove",
        () => {
          this.wanted = `${lens.key} add`;
          this.drafts.delete(lens.key);
          if (!this.put(lens, undefined, `Remove ${title} of '${name}'`)) this.refresh();
        },
        { class: "small", "aria-label": `Remove: ${title}` },
      ),
    );
  }

  /** Whether a list of the plan has a name. */
  inList(key, path, name, title) {
    let lens = this.plan(path[0]);
    for (const step of path.slice(1)) lens = lens.at(step, { drop: true });
    const box = lens.as(
      (list) => Boolean(list?.includes(name)),
      (there, list = []) => {
        const rest = list.filter((it) => it !== name);
        const now = there ? [...list, name] : rest;
        return now.length ? now : undefined;
      },
      name,
    );
    return this.labelled(title, this.check(box, title, { what: `${wordOf(key)}: ${name}` }));
  }

  // -- transitions -----------------------------------------------------------------------------------

  transitionFields(list) {
    const timed = this.net("transition", list, "timed", false).get();
    const kind = new Lens(
      `net.${list.length === 1 ? `transition:${list[0].name}` : "transitions"}.timed`,
      () => timed,
      (value, label) =>
        this.document.edit(label, ({ net }) => ({
          net: changeNodes(net, list.map(keyOf.transition), (it) =>
            Boolean(it.timed) !== value ? otherKind(it) : it,
          ),
        })),
    );
    return [
      this.labelled(
        "Kind",
        this.choice(
          kind,
          "kind",
          [
            [true, "timed (exponential)"],
            [false, "immediate"],
          ],
          { what: "the kind of transition" },
        ),
      ),
      timed === true && [
        this.netNumber("transition", list, "rate", 1, "Rate (1/s)"),
        this.servers(list),
      ],
      timed === false && [
        this.netNumber("transition", list, "weight", 1, "Weight"),
        this.netNumber("transition", list, "priority", 1, "Priority"),
      ],
    ];
  }

  servers(list) {
    const lens = this.net("transition", list, "servers", 1);
    const endless = lens.as(
      (value) => (value === MIXED ? MIXED : value === null),
      (value) => (value ? null : 1),
      "endless",
    );
    return [
      lens.get() !== null && this.netNumber("transition", list, "servers", 1, "Servers"),
      this.labelled(
        "Infinitely many servers",
        this.check(endless, "infinitely many servers", { absent: null }),
      ),
    ];
  }

  transition(name) {
    const list = this.selected("transition");
    const [{ timed }] = list;
    return [
      h("h2", name),
      this.name("transition", name),
      this.transitionFields(list),
      this.position("transition", name),
      timed && [
        this.section("transition event", "Event", Boolean(this.document.plan.events?.[name]), () =>
          this.entry("events", name),
        ),
        this.section("transition rate", "Rate that replaces the net's", false, () =>
          this.entry("rates", name),
        ),
      ],
      this.section(
        "transition routing",
        "Which robot goes where",
        Boolean(this.document.plan.routing?.[name]),
        () => this.entry("routing", name),
      ),
      this.inList("tasks.done", ["tasks", "done"], name, "A robot's task is done here"),
      this.neighbours(name),
    ];
  }

  neighbours(name) {
    const { arcs } = this.document.net;
    const around = arcs.filter(({ from, to }) => from === name || to === name);
    if (!around.length) return null;
    return [
      h("h3", "Arcs"),
      h(
        "ul.chips",
        around
          .map((arc) => [`${arc.from} → ${arc.to}`, arcKey(arc)])
          .sort(([a], [b]) => natural(a, b))
          .map(([text, key]) =>
            h(
              "li",
              this.button(`go ${key}`, text, () => this.mode.choose([key]), { class: "link" }),
            ),
          ),
      ),
    ];
  }

  // -- arcs ------------------------------------------------------------------------------------------

  arcFields(list) {
    const places = new Set(this.document.net.places.map(({ name }) => name));
    const inhibitor = this.net("arc", list, "inhibitor", false);
    return [
      this.netNumber("arc", list, "weight", 1, "Weight"),
      list.every(({ from }) => places.has(from)) &&
        this.labelled(
          "Inhibitor arc",
          this.check(inhibitor, "inhibitor arc", { what: "the kind of arc" }),
        ),
    ];
  }

  arc(list) {
    return [
      h("h2", `${list[0].from} → ${list[0].to}`),
      this.arcFields(list),
      this.drawn("arc", list, "bends", "x y x y ...", (pairs) => pairs),
      h("p.muted", "Drag the arc, or press B, to bend it."),
      h("div.buttons", [
        this.button("go from", `Go to ${list[0].from}`, () =>
          this.mode.choose([this.keyOfNode(list[0].from)]),
        ),
        this.button("go to", `Go to ${list[0].to}`, () =>
          this.mode.choose([this.keyOfNode(list[0].to)]),
        ),
      ]),
    ];
  }

  keyOfNode(name) {
    const place = this.document.net.places.some((it) => it.name === name);
    return nodeKey(place ? "place" : "transition", name);
  }
}

/** The plan with the given places turned into resource places, or into robot places. */
function withKind(plan, names, kind) {
  const those = new Set(names);
  const rest = (plan.resource_places ?? []).filter((name) => !those.has(name));
  if (kind === "resource") {
    const actions = Object.fromEntries(
      Object.entries(plan.actions ?? {}).filter(([name]) => !those.has(name)),
    );
    return { ...plan, actions, resource_places: [...rest, ...names] };
  }
  const actions = { ...plan.actions };
  for (const name of names) actions[name] ??= null;
  return changed({ ...plan, actions }, { resource_places: rest.length ? rest : undefined });
}
