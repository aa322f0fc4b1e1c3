"""Offer a robot as a tool to an agent or an MCP client. The robot's driver declares the tool. Commands of
agents pass the same checks as all other commands."""
