import {el, kindOf, setText, since, stateText} from "/page/dom.js"

/** The list of all robots. */
export class Fleet {
  constructor(orders) {
    this.orders = orders
    this.cards = new Map()
    this.grid = el("section", {class: "grid", "aria-label": "robots"})
    this.empty = el("p", {class: "empty"},
      "No robot runs. Start one in a terminal, and it appears here by itself: ", el("code", {}, "strands-actors web --twin so101"))
    this.root = el("div", {}, el("h1", {}, "Robots"), this.empty, this.grid)
  }

  show(robots) {
    this.empty.hidden = robots.length > 0
    const names = new Set(robots.map(robot => robot.name))
    for (const [name, card] of this.cards)
      if (!names.has(name)) { card.root.remove(); this.cards.delete(name) }
    for (const robot of robots) {
      if (!this.cards.has(robot.name)) {
        const card = new Card(robot.name, this.orders)
        this.cards.set(robot.name, card)
        this.grid.append(card.root)
      }
      this.cards.get(robot.name).show(robot)
    }
  }
}

class Card {
  constructor(name, orders) {
    this.state = el("span", {class: "pill"})
    this.rows = {}
    const rows = ["type", "age", "commands", "task", "battery", "refused", "problem"].map(key => {
      this.rows[key] = el("dd")
      return [el("dt", {}, key), this.rows[key]]
    })
    this.root = el("article", {class: "card"},
      el("div", {class: "row"}, el("h2", {}, el("a", {href: `#/robots/${name}`}, name)), this.state),
      el("dl", {}, rows),
      el("button", {class: "stop", onclick: () => orders.stop(name)}, `stop ${name}`))
  }

  show(robot) {
    this.root.dataset.kind = kindOf(robot)
    setText(this.state, stateText(robot))
    const values = {
      type: [robot.type, robot.host].filter(Boolean).join(" on "),
      age: since(robot.age_s),
      commands: robot.lease || "nobody",
      task: robot.task || "none",
      battery: robot.battery == null ? "" : `${Math.round(robot.battery)} %`,
      refused: robot.last_refusal,
      problem: robot.problem || (["holding", "unconfirmed", "lost"].includes(robot.state) ? robot.cause : ""),
    }
    for (const [key, value] of Object.entries(values)) {
      setText(this.rows[key], value)
      this.rows[key].hidden = this.rows[key].previousSibling.hidden = !value
    }
  }
}
