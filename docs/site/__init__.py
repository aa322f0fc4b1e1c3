"""Build the documentation site with MkDocs.

``mkdocs.yml``   the configuration and the navigation
``hook``         what MkDocs calls while it builds
``sources``      pages made of files outside ``docs/``: README, CONTRIBUTING, source files that a page links to
``markdown``     what GitHub renders differently than MkDocs: anchors, nested lists, diagrams
``robots``       a page for each robot; ``sections`` has its parts
``facts``        reads the figures of a robot, as do ``gates`` and ``options``
``api``          pages of the public packages, from their docstrings
``docstrings``   changes the layout of docstrings for the reference
``diagrams``     draws the diagrams of the pages; a person runs it after a change of a diagram
``offline``      checks that a site loads nothing from a network
"""
