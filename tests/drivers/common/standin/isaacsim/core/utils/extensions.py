import isaacsim


def enable_extension(extension_name: str) -> bool:
    isaacsim.calls.append(("extension", extension_name))
    return True
