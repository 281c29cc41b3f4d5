"""Questions that people ask of their pipes, as the SQL that answers them: to be run, shown, and changed by whoever asks
otherwise.

Year on year: each pipe's newest survey against the one nearest to a year before it, from half a year to one and a half.
Each station of the newer is held against the nearest of the older by its distance along the pipe. Stations belong to
the one of two neighbours that is nearer: an older station's reach begins half way to the one before it, so that one
ordered join finds it; pairs are numbered, for the same join by names costs half as much again. Odometers differ by 1 %,
so near the far end of 100 m the same place is 1 m off: a change of a slowly varying figure is told, a defect's growth
is not (`annulus archive compare` lays two surveys over each other).
"""

from collections.abc import Mapping
from dataclasses import dataclass

DAYS = 365  # from a survey to "the year before": the seasons' scans of one pipe ..
DAYS_MIN = 183  # .. at least half of it, or it is of the same season ..
DAYS_MAX = 548  # .. and at most one and a half, or it is of the year before that
APART_MM = 10.0  # of two stations that may be held against each other; stations are 4 to 5 mm apart


@dataclass(frozen=True, slots=True)
class Question:
    asks: str
    sql: str


QUESTIONS: Mapping[str, Question] = {
    "worst-ovality": Question(
        "Where is each pipe least round? Of the fitted shape, so that a defect is no ovality.",
        """
WITH worst AS (
  SELECT pipe, max(shape_ovality_f1216_percent) AS shape_ovality_f1216_percent,
         arg_max(survey, shape_ovality_f1216_percent) AS survey, arg_max(date, shape_ovality_f1216_percent) AS date,
         arg_max(z_mm, shape_ovality_f1216_percent) AS z_mm
  FROM stations WHERE pipe IS NOT NULL AND shape_ovality_f1216_percent IS NOT NULL GROUP BY pipe
)
SELECT pipe, date, survey, z_mm, shape_ovality_f1216_percent FROM worst ORDER BY shape_ovality_f1216_percent DESC, pipe
""",
    ),
    "year-on-year": Question(
        "What changed most on each pipe since the year before?",
        f"""
WITH newest AS (
  SELECT pipe, max_by(survey, (date, survey)) AS survey, max(date) AS date
  FROM surveys WHERE pipe IS NOT NULL AND date IS NOT NULL GROUP BY pipe
), pair AS (
  SELECT n.pipe, n.survey, n.date, min_by(o.survey, (abs(n.date - o.date - {DAYS}), o.survey)) AS before,
         min_by(o.date, (abs(n.date - o.date - {DAYS}), o.survey)) AS before_date, row_number() OVER ()::INTEGER AS n
  FROM newest n JOIN surveys o ON o.pipe = n.pipe AND n.date - o.date BETWEEN {DAYS_MIN} AND {DAYS_MAX}
  GROUP BY n.pipe, n.survey, n.date
), old AS (
  SELECT n, z_mm, shape_ovality_f1216_percent AS ovality, diameter_mean_mm, diameter_k2_mm,
         coalesce((z_mm + lag(z_mm) OVER (PARTITION BY n ORDER BY z_mm)) / 2, '-infinity'::DOUBLE) AS reach_mm
  FROM stations s JOIN pair ON s.survey = pair.before AND s.date = pair.before_date
), now AS (
  SELECT n, s.z_mm, s.shape_ovality_f1216_percent AS ovality, s.diameter_mean_mm, s.diameter_k2_mm
  FROM stations s JOIN pair ON s.survey = pair.survey AND s.date = pair.date
), change AS (
  SELECT now.n, now.z_mm, now.ovality - old.ovality AS ovality_change,
         now.diameter_mean_mm - old.diameter_mean_mm AS diameter_change,
         sqrt(now.diameter_k2_mm ** 2 + old.diameter_k2_mm ** 2) AS diameter_change_k2
  FROM now ASOF JOIN old ON now.n = old.n AND now.z_mm >= old.reach_mm
  WHERE abs(now.z_mm - old.z_mm) <= {APART_MM:g}
), most AS (
  SELECT n, count(*) AS stations_compared,
         arg_max(ovality_change, abs(ovality_change)) AS ovality_change_percent,
         arg_max(z_mm, abs(ovality_change)) AS ovality_z_mm,
         arg_max(diameter_change, abs(diameter_change)) AS diameter_change_mm,
         arg_max(diameter_change_k2, abs(diameter_change)) AS diameter_change_k2_mm,
         arg_max(z_mm, abs(diameter_change)) AS diameter_z_mm
  FROM change GROUP BY n
)
SELECT pair.pipe, pair.date, pair.survey, before_date, pair.before, most.* EXCLUDE (n)
FROM pair JOIN most USING (n) ORDER BY abs(ovality_change_percent) DESC NULLS LAST, pipe
""",
    ),
    "deepest-defects": Question(
        "Which defects of each pipe's newest survey are deepest? With the depth that is sure at k = 2.",
        """
WITH newest AS (
  SELECT max_by(survey, (date, survey)) AS survey FROM surveys WHERE pipe IS NOT NULL AND date IS NOT NULL GROUP BY pipe
)
SELECT pipe, date, survey, number, kind, z_mm, clock_deg, depth_mm, depth_k2_mm, depth_mm - depth_k2_mm AS sure_mm,
       length_mm, floor_seen
FROM defects JOIN newest USING (survey) WHERE kind <> 'ovality'
ORDER BY depth_mm DESC NULLS LAST, pipe, number LIMIT 100
""",
    ),
    "joints-out-of-line": Question(
        "Which joints of each pipe's newest survey are most out of line?",
        """
WITH newest AS (
  SELECT max_by(survey, (date, survey)) AS survey FROM surveys WHERE pipe IS NOT NULL AND date IS NOT NULL GROUP BY pipe
)
SELECT pipe, date, survey, number, kind, z_mm, hilo_mm, hilo_k2_mm, angle_deg, angle_k2_deg, gap_mm, remark
FROM joints JOIN newest USING (survey) WHERE hilo_mm IS NOT NULL OR angle_deg IS NOT NULL OR gap_mm IS NOT NULL
ORDER BY hilo_mm DESC NULLS LAST, angle_deg DESC NULLS LAST, pipe, number LIMIT 100
""",
    ),
}
