import {el, number, setText} from "/page/dom.js"

const WHOLE_TURN = 360
const ALSO_DEGREES = 5
const NAMES = {calibrate: "Calibration", "setup-motors": "Ids of servos", drill: "Drill"}

/** One command, with this page in place of the terminal. Its end, and that of the page, end the command safely.
 * `names` are the joints of the robot that can be calibrated. */
export class Run {
  constructor(order, names, {again, leave}) {
    this.order = order
    this.names = names
    this.again = again
    this.leave = leave
    this.bars = new Map()
    this.instruction = el("p", {class: "instruction", role: "status", "aria-live": "assertive"}, "starting …")
    this.question = el("div", {class: "question"})
    this.joints = el("ol", {class: "sweeps"})
    this.also = el("p", {class: "bad"})
    this.log = el("ol", {class: "said"})
    this.stop = el("button", {class: "quiet", onclick: () => this.end()}, "end it")
    this.root = el("div", {class: "run"},
      el("div", {class: "row"}, el("h2", {}, `${order.undo ? "Undo the calibration" : NAMES[order.type]}: ${order.robot}`), this.stop),
      this.instruction, this.question, this.also, this.joints, this.log)
    this.socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/setup/run`)
    this.socket.onopen = () => this.socket.send(JSON.stringify(order))
    this.socket.onmessage = event => this.receive(JSON.parse(event.data))
    this.socket.onclose = event => this.closed(event.reason)
  }

  receive(message) {
    if (!message.type) this.result = message
    else this[message.type]?.(message)
  }

  answer(number, text = "") {
    this.socket.send(JSON.stringify({number, text}))
    this.question.replaceChildren()
    setText(this.instruction, "…")
  }

  // -- what the command says and asks

  said({text}) {
    setText(this.instruction, text)
    this.note(text)
  }

  note(text, kind = "") { this.log.append(el("li", {class: kind}, text)) }

  ready({number, text}) {
    setText(this.instruction, text[0].toUpperCase() + text.slice(1))
    const done = el("button", {class: "go", onclick: () => this.answer(number)}, "done")
    this.question.replaceChildren(done)
    done.focus()
  }

  moved({joint, expected, degrees}) {
    if (!this.bars.size) for (const name of Object.keys(degrees)) this.addBar(name)
    const bar = this.bars.get(joint)
    bar.meter.max = expected ?? WHOLE_TURN
    bar.meter.value = degrees[joint]
    setText(bar.text, `${number(degrees[joint])}° of ${expected == null ? "a turn, both ways" : `about ${number(expected, 0)}°`}`)
    for (const [name, one] of this.bars) one.root.toggleAttribute("aria-current", name === joint)
    const others = Object.entries(degrees).filter(([name, moved]) => name !== joint && moved > ALSO_DEGREES)
    setText(this.also, others.length ? `${others.map(([name, moved]) => `${name} ${number(moved, 0)}°`).join(", ")} moved, too` : "")
  }

  addBar(name) {
    const meter = el("progress", {"aria-label": `${name}: how far it was moved`, value: 0, max: WHOLE_TURN}), text = el("span")
    const root = el("li", {}, el("b", {}, name), meter, text)
    this.bars.set(name, {root, meter, text})
    this.joints.append(root)
  }

  confirm({number: asked, joints, findings}) {
    setText(this.instruction, "Nothing was written yet. Are these values right?")
    setText(this.also, "")
    const titles = ["joint", "swept", "offset before", "offset", "range"]
    const write = el("button", {class: "go", onclick: () => this.answer(asked, "yes")}, "write them into the servos")
    this.question.replaceChildren(
      el("div", {class: "scroll"}, el("table", {class: "proposal"}, el("thead", {}, el("tr", {}, titles.map(title => el("th", {scope: "col"}, title)))),
        el("tbody", {}, joints.map(each => el("tr", {}, el("th", {scope: "row"}, each.joint),
          [each.swept == null ? "–" : `${number(each.swept)}°`, each.offset_before, each.offset, `${each.range_min} to ${each.range_max}`]
            .map(value => el("td", {}, String(value)))))))),
      findings.length ? el("ul", {class: "findings"}, findings.map(text => el("li", {}, text))) : el("p", {class: "good"}, "Nothing unusual was noticed."),
      el("div", {class: "row"}, write, el("button", {onclick: () => this.answer(asked, "no")}, "write nothing")))
    this.joints.hidden = true
    write.focus()
  }

  consent({number, text, word}) {
    setText(this.instruction, "Read this first.")
    const typed = el("input", {name: "word", required: true, autocomplete: "off", "aria-label": `type ${word} to consent`})
    this.question.replaceChildren(...text.split("\n\n").map(part => el("p", {}, part)),
      el("form", {class: "row", onsubmit: event => { event.preventDefault(); this.answer(number, typed.value.trim()) }},
        el("label", {class: "row"}, `Type ${word} to go on: `, typed), el("button", {class: "go"}, "drill it")))
    typed.focus()
  }

  step({result}) {
    const times = result.confirmed_ms == null ? "" : `, confirmed safe after ${number(result.confirmed_ms, 0)} ms`
    this.note(`${result.step}: ${result.passed ? "passed" : "FAILED"} (${result.safe_state}${times}). ${result.detail}`, result.passed ? "good" : "bad")
  }

  ended({code}) { this.code = code }

  // -- the end

  closed(reason) {
    this.stop.replaceWith(el("button", {onclick: this.leave}, "back"))
    this.question.replaceChildren()
    this.joints.hidden = true
    setText(this.also, "")
    const {result} = this
    const failed = result?.error ?? (result ? "" : reason || (this.code == null
      ? "The connection ended. The command was ended with it, as by Ctrl-C." : `It ended (code ${this.code}).`))
    setText(this.instruction, failed || this.summary(result))
    this.instruction.classList.add(failed || result.passed === false ? "bad" : "good")
    const isCalibration = this.order.type === "calibrate"
    const accept = failed && isCalibration && !this.order.undo ? this.acceptBoxes() : null
    this.question.append(accept ?? "", el("div", {class: "row"},
      el("button", {class: "go", onclick: () => this.again(accept ? {accept: checkedIn(accept)} : {})}, "again"),
      isCalibration && !failed && el("button", {onclick: () => this.again({undo: !this.order.undo, accept: []})},
        this.order.undo ? "undo once more" : "undo it")))
  }

  /** What may be accepted although it differs from the robot's table, as with --accept. */
  acceptBoxes() {
    return el("details", {}, el("summary", {}, "an arm with other parts: accept …"), el("fieldset", {class: "tasks"},
      el("legend", {}, "accept another range of these joints than usual, or different firmware"),
      ["firmware", ...this.names].map(word => el("label", {class: "row"},
        el("input", {type: "checkbox", value: word, checked: this.order.accept?.includes(word)}), word))))
  }

  summary(result) {
    if (this.order.type === "drill") return result.passed ? `Passed. Certificate: ${result.certificate}`
      : "Not passed: there is no certificate, and an earlier one was taken back."
    if (this.order.type === "setup-motors") return `Done: ${result.servos.map(({joint, was, id}) => `${joint} id ${was} → ${id}`).join(", ")}.`
    return this.order.undo ? `Put back. File: ${result.file}` : `Calibrated. LeRobot's file of it: ${result.file}`
  }

  end() { this.socket.close() }
}

const checkedIn = boxes => [...boxes.querySelectorAll("input:checked")].map(box => box.value)
