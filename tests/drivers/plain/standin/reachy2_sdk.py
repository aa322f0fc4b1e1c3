"""An SDK that is only looked for."""
