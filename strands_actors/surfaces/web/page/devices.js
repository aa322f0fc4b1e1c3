import {el} from "/page/dom.js"

/** The devices that may use this console, and codes that let others in. */
export class Devices {
  constructor(orders) {
    this.orders = orders
    this.list = el("ul", {class: "devices"})
    this.offer = el("div", {class: "offer"})
    const code = role => el("button", {class: role === "operator" ? "go" : "quiet", onclick: () => this.show(role)},
      `let a device in as ${role}`)
    this.root = el("div", {}, el("h1", {}, "Devices"),
      el("p", {}, "An operator may move robots. A viewer may look, and may stop them."),
      el("div", {class: "row"}, code("operator"), code("viewer")), this.offer, el("h2", {}, "Let in"), this.list)
    this.read()
  }

  async read() {
    const answer = await this.orders.get("/devices")
    if (!answer) return
    this.list.replaceChildren(...answer.devices.map(device => el("li", {},
      el("b", {}, device.role), " ", device.device, " since ", new Date(device.since_s * 1000).toLocaleTimeString(), " ",
      device.id === answer.own ? el("i", {}, "(this one)") : el("button", {class: "quiet", onclick: async () => {
        await this.orders.post("/devices/revoke", {id: device.id})
        this.read()
      }}, "send away"))))
  }

  async show(role) {
    const offered = await this.orders.post("/devices/offer", {role})
    if (!offered) return
    this.offer.replaceChildren(
      el("img", {src: offered.picture, alt: "QR code with the address", width: 260, height: 260}),
      el("div", {}, el("p", {}, `Scan it, or open ${offered.url} and type:`), el("p", {class: "code"}, offered.code),
        el("p", {}, "It works once, for two minutes. The other device warns of the certificate. Its fingerprint must be:"),
        el("p", {class: "fingerprint"}, offered.fingerprint)))
  }

  close() {}
}
