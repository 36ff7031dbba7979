// The robots of a plan: their names, initial places and own actions.

import { h } from "../dom.js";
import { Lens } from "./form.js";
import { NAMES } from "./names.js";
import { changed } from "./net_edits.js";
import { group, schemaField } from "./schema_form.js";

/** The robots of a plan as a list of {name, place, actions, capabilities}; robots without a name in the plan follow
 * from its tokens. */
export function robotsOf({ plan, net }) {
  if (Array.isArray(plan.robots)) return plan.robots;
  if (plan.robots) return Object.entries(plan.robots).map(([name, place]) => ({ name, place }));
  let count = 0;
  return net.places
    .filter(({ name }) => !plan.resource_places?.includes(name))
    .flatMap(({ name, tokens }) =>
      Array.from({ length: Math.min(tokens ?? 0, 1000) }, () => ({
        name: `robot_${++count}`,
        place: name,
      })),
    );
}

/** The robots as written in the plan: an object if no robot has its own actions or capabilities. */
function written(robots, before) {
  return Array.isArray(before) ||
    robots.some(({ actions, capabilities }) => actions || capabilities)
    ? robots
    : Object.fromEntries(robots.map(({ name, place }) => [name, place]));
}

/** A lens at the list of robots. Each place gets or loses a token for each robot that comes or goes. */
export const robotsLens = (form) =>
  new Lens(
    "plan.robots",
    () => robotsOf(form.state),
    (robots, label, merge) =>
      form.document.edit(
        label,
        (state) => {
          const { plan, net } = state;
          const before = robotsOf(state);
          const count = (list, name) => list.filter(({ place }) => place === name).length;
          const places = net.places.map((place) => {
            const more = count(robots, place.name) - count(before, place.name);
            const tokens = Math.max(0, (place.tokens ?? 0) + more) || undefined;
            return more ? changed(place, { tokens }) : place;
          });
          return {
            plan: { ...plan, robots: written(robots, plan.robots) },
            net: { ...net, places },
          };
        },
        merge,
      ),
  );

function free(robots) {
  let n = robots.length + 1;
  while (robots.some(({ name }) => name === `robot_${n}`)) n++;
  return `robot_${n}`;
}

/** Add a robot in a place. */
export function addRobot(form, place) {
  const lens = robotsLens(form);
  const robots = lens.get();
  const name = free(robots);
  form.wanted = `plan.robots.${robots.length}.name`;
  form.put(lens, [...robots, { name, place }], `Add the robot ${name}`);
}

export function robotsForm(form, _lens, title) {
  const lens = robotsLens(form);
  const robots = lens.get();
  const named = form.document.plan.robots !== undefined;
  const places = NAMES.actionPlaces(form.state);
  return group(
    title,
    !named &&
      h(
        "p.muted",
        "The plan names no robots; there is one for each token of the initial marking. " +
          "The first change here names them.",
      ),
    h(
      "div.rows",
      robots.map((robot, i) => robotRow(form, lens, robot, i, places)),
    ),
    h(
      "div.buttons",
      form.button(
        "plan.robots add",
        "Add a robot",
        () => addRobot(form, robots.at(-1)?.place ?? places[0]),
        {
          disabled: !places.length,
        },
      ),
      named &&
        form.button(
          "plan.robots by tokens",
          "Derive from tokens",
          () =>
            form.put(form.plan("robots", false), undefined, "Derive the robots from the tokens"),
          { title: "One robot for each token of the initial marking, without names in the plan" },
        ),
    ),
  );
}

export function robotRow(form, lens, robot, i, places) {
  const at = lens.at(i, { given: true });
  const name = at.at("name");
  const actions = at.at("actions", { drop: true });
  const mapped = NAMES.actionPlaces(form.state).filter(
    (place) => !(place in (robot.actions ?? {})),
  );
  return h(
    "div.robot-row",
    { role: "group", "aria-label": `Robot ${robot.name}` },
    h(
      "div.entry",
      form.text(name, `name of the robot ${robot.name}`, {
        "aria-label": "Name of the robot",
        late: true,
        parse: (text) => {
          if (!text.trim()) return "a name is needed";
          return lens.get().some((other, at_) => at_ !== i && other.name === text)
            ? "another robot has this name"
            : [text];
        },
      }),
      form.choice(
        at.at("place"),
        `place of the robot ${robot.name}`,
        places.map((place) => [place, place]),
        { "aria-label": `Initial place of ${robot.name}` },
      ),
      form.removal(at, `the robot ${robot.name}`, "plan.robots add"),
    ),
    form.labelled(
      "Capabilities",
      form.text(
        at.at("capabilities", { drop: true }),
        `the capabilities of the robot ${robot.name}`,
        {
          "aria-label": `Capabilities of ${robot.name}`,
          late: true,
          show: (words) => (words ?? []).join(", "),
          parse: (text) => {
            const words = text.split(",").map((word) => word.trim());
            const reported = [...new Set(words.filter(Boolean))];
            return [reported.length ? reported : undefined];
          },
        },
      ),
      "Words by which a task may ask for such robots, separated by commas.",
    ),
    form.section(
      actions.key,
      `Own actions${robot.actions ? ` (${Object.keys(robot.actions).length})` : ""}`,
      false,
      Object.keys(robot.actions ?? {}).map((place) => {
        const own = actions.at(place, { given: true });
        return group(
          place,
          schemaField(
            form,
            { $ref: "#/definitions/action" },
            own,
            `Action of ${robot.name} in ${place}`,
          ),
          form.removal(
            own,
            `the action of ${robot.name} in ${place}`,
            null,
            `Remove an action of ${robot.name}`,
          ),
        );
      }),
      form.adder(actions.key, `Another action of ${robot.name} in`, mapped, (place) =>
        form.put(
          actions.at(place),
          form.document.plan.actions[place]?.plan === undefined
            ? (form.document.plan.actions[place] ?? null)
            : null,
          `Give ${robot.name} its own action`,
        ),
      ),
    ),
  );
}
