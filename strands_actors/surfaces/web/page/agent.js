import {el, setText} from "/page/dom.js"

const TITLES = {
  prompt: entry => entry.by, text: () => "agent", asks: entry => `asks ${entry.tool}`, got: entry => `${entry.tool} answers`,
  refused: entry => `${entry.tool} refuses`, failed: () => "failed", ended: () => "ended",
}
const NEAR_END = 80

/** The conversation with the agent. It is kept while other views are shown. */
export class Agent {
  static log = el("ol", {class: "talk", role: "log", "aria-label": "conversation with the agent", tabindex: 0})
  static busy = false
  static shown = null

  static receive(message) {
    if (message.type !== "agent") return
    if (message.first) Agent.log.replaceChildren()
    const follows = Agent.log.scrollHeight - Agent.log.scrollTop - Agent.log.clientHeight < NEAR_END
    for (const entry of message.entries) Agent.add(entry)
    if (follows) Agent.log.scrollTop = Agent.log.scrollHeight
    Agent.busy = message.busy
    Agent.shown?.update()
  }

  static add(entry) {
    const last = Agent.log.lastChild
    if (entry.kind === "text" && last?.dataset.kind === "text") { last.lastChild.append(entry.text); return }
    if (entry.kind in TITLES)
      Agent.log.append(el("li", {"data-kind": entry.kind}, el("b", {}, TITLES[entry.kind](entry)), el("p", {}, entry.text)))
  }

  constructor(orders) {
    this.orders = orders
    this.words = el("textarea", {rows: 2, maxlength: 4000, required: true, "aria-label": "words to the agent",
      placeholder: "What runs here?", onkeydown: event => { if (event.key === "Enter" && !event.shiftKey) this.say(event) }})
    this.send = el("button", {class: "go"}, "say")
    this.stop = el("button", {type: "button", class: "stop outline", onclick: () => orders.post("/agent/stop")}, "stop the agent")
    this.state = el("p", {class: "agent-state", role: "status"})
    this.root = el("div", {class: "agent-view"}, el("h1", {}, "Agent"),
      el("p", {}, "It sees the robots, and can stop them. Each task that it wants to start asks an operator first. "
        + "Stopping the agent stops no robot."),
      Agent.log, this.state, el("form", {class: "say", onsubmit: event => this.say(event)}, this.words, this.send, this.stop))
    Agent.shown = this
    this.update()
    requestAnimationFrame(() => { Agent.log.scrollTop = Agent.log.scrollHeight })
  }

  update() {
    this.send.disabled = Agent.busy
    setText(this.state, Agent.busy ? "the agent works …" : "")
  }

  async say(event) {
    event.preventDefault()
    const text = this.words.value.trim()
    if (text && !Agent.busy && await this.orders.post("/agent/say", {text})) this.words.value = ""
  }

  close() { Agent.shown = null }
}
