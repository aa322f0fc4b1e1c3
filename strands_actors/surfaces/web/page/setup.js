import {el, setText} from "/page/dom.js"
import {Run} from "/page/setup_run.js"

const PORTS_MS = 1000
const UNPLUGGED_MS = 20000
const TASKS = [
  ["setup-motors", "give new servos their ids", "You connect one servo at a time, the last joint first."],
  ["calibrate", "calibrate", "You move each joint by hand from one end to the other. No motor is energised."],
  ["undo", "undo the last calibration", "The servos and the file get the values from before the last calibration."],
  ["drill", "drill", "Stops the robot in each way a fault can, measures it, and gives a certificate if all pass."],
]

/** What a new robot needs, without a terminal: this computer, ports, ids of motors, calibration, drill. */
export class SetUp {
  constructor(orders) {
    this.orders = orders
    this.known = new Map()
    this.isFirst = true
    this.ports = el("ul", {class: "ports", "aria-live": "polite"})
    this.portNames = el("datalist", {id: "port-names"})
    this.checks = el("div")
    this.place = el("div")
    this.doctor = el("button", {onclick: () => this.check()}, "check this computer")
    this.root = el("div", {class: "setup"}, el("h1", {}, "Set up"),
      el("section", {class: "below"}, el("h2", {}, "Ports"),
        el("p", {class: "hint"}, "Which adapter is which? Unplug one: its line says so. Then plug it in again."), this.ports),
      el("section", {class: "below"}, el("div", {class: "row"}, el("h2", {}, "This computer"), this.doctor), this.checks),
      el("section", {class: "below wide"}, this.portNames, this.place))
    this.showForm()
    this.look()
    orders.get("/setup/kinds").then(answer => { if (answer) { this.kinds = answer.kinds; this.offerKinds() } })
  }

  // -- ports

  async look() {
    try {
      const answer = await fetch("/setup/ports")
      if (answer.ok) this.showPorts((await answer.json()).ports)
      else setText(this.ports, await answer.text())
    } catch { setText(this.ports, "no answer: is the console still running?") }
    if (!this.isClosed) this.timer = setTimeout(() => this.look(), PORTS_MS)
  }

  showPorts(ports) {
    const now = performance.now()
    for (const {port, about} of ports) {
      const old = this.known.get(port)
      this.known.set(port, {about, state: old?.gone || (!old && !this.isFirst) ? "just plugged in" : old?.state ?? ""})
    }
    for (const [port, one] of this.known) {
      if (ports.some(each => each.port === port)) continue
      one.gone ??= now
      one.state = "just unplugged: this is the one"
      if (now - one.gone > UNPLUGGED_MS) this.known.delete(port)
    }
    this.isFirst = false
    const text = JSON.stringify([...this.known])
    if (text === this.shownPorts) return
    this.shownPorts = text
    this.ports.replaceChildren(...[...this.known].map(([port, {about, state, gone}]) => el("li", {class: gone ? "gone" : ""},
      el("b", {}, port), el("span", {}, about), state && el("em", {}, state),
      !gone && el("button", {class: "quiet", "aria-label": `use ${port}`, onclick: () => this.use(port)}, "use"))))
    if (!this.known.size) this.ports.append(el("li", {}, "No serial adapter is plugged in."))
    this.portNames.replaceChildren(...ports.map(({port}) => el("option", {value: port})))
  }

  use(port) {
    if (!this.form) return
    this.form.elements.port.value = port
    this.form.elements.port.focus()
  }

  // -- doctor

  async check() {
    this.doctor.disabled = true
    this.checks.replaceChildren(el("p", {role: "status"}, "checking. It takes some seconds …"))
    const answer = await this.orders.post("/setup/doctor")
    this.doctor.disabled = false
    this.checks.replaceChildren()
    if (!answer) return
    const good = answer.checks.filter(check => ["ok", "note"].includes(check.state)), bad = answer.checks.filter(check => !good.includes(check))
    const rows = checks => el("ul", {class: "checks"}, checks.map(check => el("li", {class: check.state},
      el("b", {}, check.state), " ", el("span", {}, `${check.name}: ${check.found}`),
      check.remedy && el("small", {}, check.remedy))))
    this.checks.append(
      el("p", {role: "status", class: answer.ok ? "good" : "bad"}, answer.ok
        ? bad.length ? "Robots run here. Something works less well:" : "Everything a robot needs is here." : "Something is missing that every robot needs:"),
      rows(bad), el("details", {}, el("summary", {}, `${good.length} checks without a finding`), rows(good)))
  }

  // -- the form

  showForm() {
    const input = (name, label, attributes) => el("label", {}, label, el("input", {name, autocomplete: "off", ...attributes}))
    this.robots = el("select", {name: "robot", required: true})
    this.task = TASKS[1][0]
    this.hint = el("p", {class: "hint"})
    this.simulated = el("input", {type: "checkbox", name: "twin", onchange: () => this.choose()})
    this.simulatedLabel = el("label", {class: "row"}, this.simulated, "a simulated one")
    const tasks = TASKS.map(([task, text]) => el("label", {class: "row"}, el("input", {
      type: "radio", name: "task", value: task, checked: task === this.task, onchange: () => { this.task = task; this.choose() }}), text))
    this.go = el("button", {class: "go"}, "begin")
    this.form = el("form", {onsubmit: event => { event.preventDefault(); this.begin() }},
      el("h2", {}, "A robot"), el("fieldset", {class: "tasks"}, el("legend", {}, "what to do"), tasks), this.hint,
      el("div", {class: "fields"}, el("label", {}, "robot or leader arm", this.robots),
        input("port", "port", {list: "port-names", placeholder: "/dev/ttyACM0"}),
        input("id", "id (its own name, if you have several)", {maxlength: 60, placeholder: "optional"}), this.simulatedLabel, this.go))
    this.place.replaceChildren(this.form)
    this.offerKinds()
  }

  offerKinds() {
    if (!this.kinds || !this.form) return
    const kept = this.robots.value || localStorage.getItem("setup-robot") || "so101"
    const fits = this.kinds.filter(kind => this.task === "drill" ? kind.drills : kind.joints.length)
    this.robots.replaceChildren(...fits.map(kind => el("option", {value: kind.name, selected: kind.name === kept}, kind.name)))
    this.choose(false)
  }

  choose(again = true) {
    if (again) { this.offerKinds(); return }
    setText(this.hint, TASKS.find(([task]) => task === this.task)[2])
    const isDrill = this.task === "drill"
    this.simulatedLabel.hidden = !isDrill
    const {port, id} = this.form.elements
    port.disabled = isDrill && this.simulated.checked
    port.required = !port.disabled
    id.disabled = this.task === "setup-motors"
  }

  begin() {
    const {robot, port, id} = this.form.elements
    localStorage.setItem("setup-robot", robot.value)
    const order = {type: this.task === "undo" ? "calibrate" : this.task, robot: robot.value}
    if (!port.disabled) order.port = port.value.trim()
    if (!id.disabled && id.value.trim()) order.id = id.value.trim()
    if (this.task === "undo") order.undo = true
    this.start(order)
  }

  start(order) {
    this.form = null
    const joints = this.kinds?.find(kind => kind.name === order.robot)?.joints ?? []
    this.run = new Run(order, joints, {
      again: changed => this.start({...order, ...changed}),
      leave: () => { this.run = null; this.showForm() },
    })
    this.place.replaceChildren(this.run.root)
    this.run.root.scrollIntoView({block: "nearest"})
  }

  close() {
    this.isClosed = true
    clearTimeout(this.timer)
    this.run?.end()
  }
}
