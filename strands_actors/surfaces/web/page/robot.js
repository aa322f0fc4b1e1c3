import {el, kindOf, number, setText, since, stateText} from "/page/dom.js"
import {Gamepads} from "/page/gamepad.js"
import {Hand} from "/page/hand.js"
import {PANELS} from "/page/panels.js"
import {Plots} from "/page/plots.js"
import {RobotScene} from "/page/scene.js"

const MOST_EVENTS = 40
const TOOL_WORDS = {
  "ee.x": "tool ahead", "ee.y": "tool to the left", "ee.z": "tool up", "ee.wx": "tool about x", "ee.wy": "tool about y",
  "ee.wz": "tool about z"}
const SPEEDS = [["slow", 0.2], ["half", 0.5], ["full", 1]]

/** One robot: in 3-D, its joints with jog buttons, plots, cameras, what happened, and its orders. */
export class RobotView {
  constructor(name, orders, mayCommand) {
    this.name = name
    this.orders = orders
    this.mayCommand = mayCommand
    this.axes = {}
    this.units = {}
    this.rows = new Map()
    this.hand = new Hand((held, rates) => orders.jog({held, at_ms: performance.now(), rates}))
    this.state = el("span", {class: "pill big"})
    this.why = el("p", {class: "why"})
    this.facts = el("dl", {class: "facts"})
    this.pad = el("p", {class: "pad"})
    this.toolTable = el("table", {class: "joints tool", hidden: true})
    this.toolButton = el("button", {class: "quiet", onclick: () => {
      this.toolButton.disabled = true
      orders.tool()
    }}, "jog the tool, too")
    this.seat = el("p", {class: "seat", role: "status", "aria-live": "polite"})
    this.table = el("table", {class: "joints"})
    this.events = el("ol", {class: "events", tabindex: 0, "aria-label": "what happened"})
    this.cameras = el("div", {class: "cameras"})
    this.sensors = el("dl", {class: "facts"})
    this.sensorsTitle = el("h2", {hidden: true}, "Sensors")
    this.canvas = el("canvas", {"aria-label": `${name} in 3-D`, role: "img"})
    this.noModel = el("p", {class: "no-model"}, "reading the model …")
    this.plots = new Plots()
    this.poses = el("ul", {class: "poses"})
    this.panels = PANELS.map(Panel => new Panel(name, orders, mayCommand))
    this.root = this.build()
    orders.get(`/robots/${name}/poses`).then(answer => answer && this.showPoses(answer.poses))
    this.scene = new RobotScene(this.canvas)
    this.scene.load(`/robots/${name}/scene`).then(() => { this.noModel.hidden = true; this.showScene() })
      .catch(problem => setText(this.noModel, problem.message))
  }

  build() {
    const {orders, name, mayCommand} = this
    const button = (text, kind, action, title) => el("button", {class: kind, onclick: action, title}, text)
    const speeds = SPEEDS.map(([text, share]) => el("label", {}, el("input", {
      type: "radio", name: "speed", checked: share === this.hand.speed, onchange: () => { this.hand.speed = share }}), text))
    return el("div", {class: "robot"},
      el("section", {class: "stage"}, this.canvas, this.noModel, this.cameras),
      el("section", {class: "side"},
        el("div", {class: "row"}, el("h1", {}, name), this.state), this.why,
        el("div", {class: "row orders"},
          button("stop", "stop", () => orders.stop(name), "space"),
          button("e-stop", "stop outline", () => orders.estop(name), "stops and locks"),
          mayCommand && button("resume", "go", () => orders.resume(name), "energises at the measured position")),
        this.facts,
        mayCommand && el("fieldset", {class: "row speeds"}, el("legend", {}, "jog: hold − or +, let go to hold. With a gamepad: hold a shoulder button"), ...speeds),
        this.seat, this.pad, this.table, this.toolTable, mayCommand && this.toolButton),
      el("section", {class: "below"}, this.plots.root),
      el("section", {class: "below"}, el("h2", {}, "What happened"), this.events, this.sensorsTitle, this.sensors,
        el("h2", {}, "Poses"), this.poses, mayCommand && this.poseForm(), mayCommand && this.policyForm()),
      ...this.panels.map(panel => el("section", {class: "below"}, panel.root)))
  }

  poseForm() {
    const name = el("input", {name: "pose", maxlength: 40, required: true, placeholder: "name", "aria-label": "name of the pose"})
    const store = async event => {
      event.preventDefault()
      const answer = await this.orders.post(`/robots/${this.name}/poses/store`, {name: name.value})
      if (answer) { this.showPoses(answer.poses); name.value = "" }
    }
    return el("form", {class: "policy", onsubmit: store}, name, el("button", {}, "store where it is now"))
  }

  showPoses(poses) {
    this.poses.replaceChildren(...Object.entries(poses).map(([name, targets]) => el("li", {},
      el("button", {disabled: !this.mayCommand, onclick: () => this.orders.pose(this.name, name, targets)}, `go to ${name}`),
      this.mayCommand && el("button", {class: "quiet", "aria-label": `remove ${name}`, onclick: async () => {
        const answer = await this.orders.post(`/robots/${this.name}/poses/remove`, {name})
        if (answer) this.showPoses(answer.poses)
      }}, "×"))))
  }

  policyForm() {
    const provider = el("input", {name: "provider", value: "mock", required: true})
    const instruction = el("input", {name: "instruction", value: "wave", required: true})
    const seconds = el("input", {name: "seconds", type: "number", value: 5, min: 1, max: 3600, required: true})
    const start = event => {
      event.preventDefault()
      this.orders.policy(this.name, {
        provider: provider.value, instruction: instruction.value, duration: Number(seconds.value)})
    }
    return el("form", {class: "policy", onsubmit: start}, el("h2", {}, "Run a policy"),
      el("label", {}, "policy", provider), el("label", {}, "instruction", instruction),
      el("label", {}, "seconds", seconds), el("button", {class: "go"}, "run"))
  }

  // -- what the server sends

  summary(robot) {
    this.root.dataset.kind = this.state.dataset.kind = kindOf(robot)
    setText(this.state, stateText(robot))
    for (const panel of this.panels) panel.summary?.(robot)
    setText(this.why, robot.problem || (robot.state === "armed" ? "" : robot.cause))
    this.pairs(this.facts, {
      type: robot.type, host: robot.host, "commanded by": robot.lease || "nobody", task: robot.task || "none",
      age: since(robot.age_s), epoch: String(robot.epoch),
      battery: robot.battery == null ? "" : `${Math.round(robot.battery)} %`, "last refusal": robot.last_refusal})
  }

  setAxes(axes, reason) {
    this.axes = axes
    this.hasAxes = true
    this.table.replaceChildren()
    this.rows.clear()
    if (reason) setText(this.seat, reason)
    this.setTool([])
    this.toolButton.disabled = false
  }

  /** Let the hand move the tool of the arm, by the keys of its pose. */
  setTool(keys) {
    this.hand.pads = this.mayCommand ? new Gamepads(Object.keys(this.axes), keys, word => this.recorderKey(word)) : null
    this.toolTable.hidden = !keys.length
    this.toolButton.hidden = keys.length > 0
    this.toolTable.replaceChildren(...keys.map(key => el("tr", {}, el("td", {}, this.hand.button(key, -1)),
      el("th", {scope: "row"}, TOOL_WORDS[key] ?? key), el("td", {}, this.hand.button(key, 1)))))
  }

  /** Pass a button of the recorder on to the panel that has the recorder. */
  recorderKey(word) {
    for (const panel of this.panels) panel.recorderKey?.(word)
  }

  setFacts(topics) {
    this.units = topics.presence?.model_units ?? {}
    const names = topics.health?.cameras ? Object.keys(topics.health.cameras) : topics.presence?.cameras ?? []
    if (names.join() !== this.cameraNames) {
      this.cameraNames = names.join()
      this.cameras.replaceChildren(...names.map(camera =>
        el("img", {src: `/robots/${this.name}/cameras/${camera}`, alt: `camera ${camera}`})))
    }
    const shown = {}
    for (const topic of ["battery", "imu", "odom", "pose"])
      for (const [field, value] of Object.entries(topics[topic] ?? {}))
        if (field !== "t" && field !== "peer_id") shown[`${topic} ${field}`] = textOf(value)
    this.pairs(this.sensors, shown)
    this.sensorsTitle.hidden = !Object.keys(shown).length
  }

  reading(reading) {
    this.newest = reading
    this.showScene()
    setText(this.pad, this.hand.pads?.text ?? "")
    if (!this.hasAxes) return
    for (const joint of reading.joints) {
      const row = this.rows.get(joint.name) ?? this.addRow(joint.name)
      setText(row.value, number(joint.measured))
      setText(row.goal, number(joint.commanded))
      const {low, high} = this.axes[joint.name] ?? {}
      const share = value => `${Math.max(0, Math.min(100, (value - low) / (high - low) * 100))}%`
      const bounded = low != null && high != null && joint.measured != null
      row.bar.hidden = !bounded
      if (bounded) row.bar.firstChild.style.left = share(joint.measured)
      row.bar.lastChild.hidden = joint.commanded == null
      if (bounded && joint.commanded != null) row.bar.lastChild.style.left = share(joint.commanded)
    }
    this.plots.add(reading)
    if (!this.plots.joint && reading.joints.length) this.select(reading.joints[0].name)
  }

  showScene() {
    if (this.newest) this.scene.show(this.newest.joints, this.units)
  }

  happened(events) {
    for (const event of events)
      this.events.prepend(el("li", {class: `level${event.level}`},
        el("time", {}, new Date(event.t * 1000).toLocaleTimeString()), " ", event.text, event.count > 1 ? ` (${event.count} times)` : ""))
    while (this.events.children.length > MOST_EVENTS) this.events.lastChild.remove()
  }

  seated(state, reason) {
    const held = this.hand.down.size > 0
    setText(this.seat, state === "engaged" ? `you move the robot${reason ? `. ${reason}` : ""}` : held || !/not held/.test(reason) ? reason : "")
    this.seat.classList.toggle("engaged", state === "engaged")
  }

  addRow(name) {
    const axis = this.axes[name] ?? {}
    const value = el("td", {class: "value"}), goal = el("td", {class: "value goal"})
    const bar = el("div", {class: "bar"}, el("i", {class: "is"}), el("i", {class: "to"}))
    const range = axis.low == null || axis.high == null ? "" : `${number(axis.low, 0)} … ${number(axis.high, 0)}`
    const jogs = this.mayCommand && name in this.axes, select = () => this.select(name)
    const row = el("tr", {},
      el("th", {scope: "row"}, el("button", {class: "name", onclick: select}, name),
        el("small", {}, [range, axis.unit].filter(Boolean).join(" ")), bar),
      jogs && el("td", {}, this.hand.button(name, -1, select)), value, goal,
      jogs && el("td", {}, this.hand.button(name, 1, select)))
    if (!this.rows.size)
      this.table.append(el("tr", {}, el("th", {scope: "col"}, "joint"), jogs && el("td"), el("th", {scope: "col"}, "is"),
        el("th", {scope: "col"}, "goal"), jogs && el("td")))
    this.table.append(row)
    this.rows.set(name, {row, value, goal, bar})
    return this.rows.get(name)
  }

  select(name) {
    for (const [each, {row}] of this.rows) row.classList.toggle("selected", each === name)
    this.plots.select(name, this.axes[name]?.unit ?? "")
  }

  pairs(list, values) {
    const shown = Object.entries(values).filter(([, value]) => value !== "")
    const keys = shown.map(([key]) => key).join()
    if (list.dataset.keys !== keys) {
      list.dataset.keys = keys
      list.replaceChildren(...shown.flatMap(([key]) => [el("dt", {}, key), el("dd")]))
    }
    shown.forEach(([, value], at) => setText(list.children[2 * at + 1], value))
  }

  close() {
    this.hand.close()
    for (const panel of this.panels) panel.close?.()
    this.scene.close()
    this.plots.close()
  }
}

function textOf(value) {
  if (typeof value === "number") return number(value, 2)
  if (Array.isArray(value)) return value.map(textOf).join(", ")
  return typeof value === "object" ? JSON.stringify(value) : String(value)
}
