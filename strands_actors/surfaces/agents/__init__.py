"""A robot as a tool of somebody else: an agent, an MCP client. Declared by its driver, gated like
every writer."""
