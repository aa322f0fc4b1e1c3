"""The looks of the Franka arms (see ``drivers/common/simulation_control/looks``).

The arms differ in the colour of their caps.
"""

from __future__ import annotations

_ROWS = """
base white can 0,0,0:.074,.092,3 0,0,.040:.070,.084,3 0,0,.100:.060,.064,2.5 0,0,.140:.056 r.012
base white rod -.145,0,.036:.056,.034,4 -.08,0,.046:.074,.045,4 0,0,.050:.080,.050,3 r.024
base {cap} can 0,0,.132:.0565 0,0,.143:.0565
link1 white rod 0,0,-.190:.056 0,0,-.12:.057 0,-.030,-.05:.058 0,-.060,0:.055 r.010
link1 white can 0,-.124,0:.055 0,-.004,0:.055
link1 {cap} can 0,-.120,0:.047 0,-.131,0:.044
link2 white can 0,0,.002:.055 0,0,.124:.055
link2 {cap} can 0,0,.120:.047 0,0,.131:.044
link2 white rod 0,0,.060:.055 0,-.060,.035:.057 0,-.12,.005:.057 0,-.192,0:.056 r.03
link2 {cap} can 0,-.186,0:.0565 0,-.197,0:.0565
link3 white rod 0,0,-.118:.056 0,0,-.060:.056 .030,.030,-.010:.055 .070,.052,0:.053 r.010
link3 white can .0825,.004,0:.055 .0825,.104,0:.055
link3 {cap} can .0825,.100,0:.047 .0825,.111,0:.044
link4 white can 0,0,.002:.055 0,0,.104:.055
link4 {cap} can 0,0,.100:.047 0,0,.111:.044
link4 white rod -.010,.0,.052:.053 -.045,.030,.030:.055 -.078,.075,.006:.056 -.0825,.122,0:.055 r.03
link4 {cap} can -.0825,.116,0:.0555 -.0825,.127,0:.0555
link5 white rod 0,0,-.256:.055 0,.010,-.20:.057 0,.042,-.11:.050 0,.062,-.04:.046 0,.066,0:.046 r.010
link5 white can 0,.004,0:.050 0,.118,0:.050
link5 {cap} can 0,.114,0:.042 0,.126,0:.040
link6 white can 0,0,-.044:.049 0,0,.052:.049
link6 white rod 0,0,.0:.047 .040,.0,0:.049 .086,.004,0:.046 r.03
link6 white can .088,-.050,0:.046 .088,.056,0:.046
link6 {cap} can .088,.052,0:.038 .088,.064,0:.036
link7 silver can 0,0,.050:.045 0,0,.076:.045
link7 {cap} can 0,0,.072:.046 0,0,.086:.046
link7 silver can 0,0,.084:.034 0,0,.107:.032
link7 {cap} box .055,.0,.068 .018,.022,.014 .006
"""


def looks_of(fci: int) -> str:
    """Return the table of looks of an arm, by the version of its FCI."""
    return _ROWS.replace("{cap}", "grey" if fci < 10 else "graphite")
