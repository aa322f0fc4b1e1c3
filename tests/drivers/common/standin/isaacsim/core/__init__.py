import isaacsim

assert isaacsim.running, "nothing of it can be imported before its app runs"
