import {el, setText} from "/page/dom.js"

const TICK_MS = 250

/** Questions of programs to the operators. Each is a card on every page, until its end is known. */
export class Consents {
  constructor(root, orders, mayCommand) {
    this.root = root
    this.orders = orders
    this.mayCommand = mayCommand
    this.cards = new Map()
    setInterval(() => { for (const card of this.cards.values()) card.tick() }, TICK_MS)
  }

  receive(message) {
    if (message.type !== "consent") return
    const ids = new Set(message.cards.map(card => card.id))
    for (const [id, card] of this.cards)
      if (!ids.has(id)) { card.root.remove(); this.cards.delete(id) }
    for (const card of message.cards) {
      if (!this.cards.has(card.id)) {
        const made = new Card(card, this.orders, this.mayCommand)
        this.cards.set(card.id, made)
        this.root.append(made.root)
      }
      this.cards.get(card.id).show(card)
    }
  }
}

class Card {
  constructor(card, orders, mayCommand) {
    const title = `consent${card.id}`
    this.mayCommand = mayCommand
    this.left = el("p", {class: "left"})
    this.bar = el("progress", {max: card.within_s, "aria-label": "time left for the answer"})
    const answer = approve => orders.post(`/consent/${card.id}`, {approve})
    this.buttons = el("div", {class: "row", hidden: !mayCommand},
      el("button", {class: "go", onclick: () => answer(true)}, "approve"),
      el("button", {class: "stop", onclick: () => answer(false)}, "refuse"))
    this.root = el("article", {class: "consent", "aria-labelledby": title},
      el("h2", {id: title}, `${card.by} asks for ${card.robot}: ${card.verb}`),
      el("dl", {}, Object.entries(card.inputs).flatMap(([name, value]) => [el("dt", {}, name), el("dd", {}, value)])),
      this.bar, this.left, this.buttons)
  }

  show(card) {
    this.card = card
    this.until = performance.now() + card.left_s * 1000
    this.root.dataset.state = card.state
    this.buttons.hidden = !this.mayCommand || card.state !== "waiting"
    this.bar.hidden = card.state !== "waiting"
    this.tick()
  }

  tick() {
    const {state, answered_by} = this.card
    if (state !== "waiting") {
      const text = {"timed out": "Nobody has answered in time, so it was refused.", withdrawn: "The program has ended, or asks no more."}
      setText(this.left, text[state] ?? `It was ${state} by ${answered_by}.`)
      return
    }
    const left = Math.max(0, (this.until - performance.now()) / 1000)
    this.bar.value = left
    setText(this.left, `${this.mayCommand ? "" : "An operator has to answer. "}${Math.ceil(left)} s left, then it is refused.`)
  }
}
