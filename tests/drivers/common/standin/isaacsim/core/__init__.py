import isaacsim

assert isaacsim.running, "isaacsim.core cannot be imported before the app runs"
