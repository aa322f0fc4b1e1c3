import isaacsim


def create_new_stage() -> bool:
    isaacsim.imported.clear()
    return True
