// How well the simulated twins of a run fit what was measured: the paper's Fig. 7 for stored trials.

import { all, get, withQuery } from './api.js'
import { boxes } from './boxes.js'
import { chart } from './chart.js'
import { NUMERALS } from './contacts.js'
import { el, facts, fill, pane, panel, replacing, say, select } from './dom.js'
import { about, count, counted, fixed, percent } from './format.js'
import { sequential } from './frame.js'
import { BEGUN } from './runwords.js'
import { scaleBar } from './scalebar.js'
import { nearest, sensorOf, skin, tips } from './skin.js'
import { paper } from './vocabulary.js'

/** Trials of which the voltages are compared one by one: newest with contacts. */
const SAMPLE = 40, DOTS = 6000
const FVU_WORDS = 'FVU is the share of the variance of the measured voltages that the simulation does not explain (Eq. 2): 0 is perfect.'

/** Makes the part of the page on the fit; `choose(run)` is called when a person takes another run. */
export function fit({ choose, signal: page }) {
  const body = el('div', { className: 'page' }), picker = el('div', { className: 'row' }), told = el('p', { className: 'soft' }, 'Reading the runs …')
  const node = el('div', { className: 'page' }, panel('How well does the simulation fit? (paper, Fig. 7)', {}, picker, told), body)
  const comparing = replacing(page)
  let runs = null, shown = null, signal = page, choice = null

  async function show(wanted) {
    try { runs ??= await all('/runs', BEGUN, { most: 200, signal: page }) } catch (error) { return void say(told, `The runs could not be read: ${error.message}`) }
    const run = runs.find(run => String(run.scan_id) === wanted || run.uid === wanted)
      ?? runs.find(run => run.ended_at) ?? runs[0]
    if (!run) return void say(told, 'No run is stored yet. After the first one, its trials are compared with their simulated twins here.')
    // Made once: another one would lose the focus at each choice.
    if (!choice) {
      choice = select(runs.map(run => [run.scan_id, `${run.scan_id} ${run.experiment}${run.label === 'virtual' ? ' (virtual)' : ''}`]), run.scan_id, choose)
      fill(picker, el('label', { className: 'inline' }, 'Run', choice))
    }
    choice.value = run.scan_id
    if (shown === run.uid) return undefined
    shown = run.uid
    // The charts of the run before end: two of the same name would write one zoom.
    signal = comparing()
    say(told, 'Comparing …')
    try {
      const report = await get(`/runs/${run.scan_id}/evaluation/simulation`, {}, { signal, wait: 60_000 })
      if (shown === run.uid) await draw(run, report)
    } catch (error) {
      if (!page.aborted && shown === run.uid) { shown = null; fill(body); say(told, `The comparison failed: ${error.message}`) }
    }
    return undefined
  }

  async function draw(run, report) {
    const query = `/api/v1/runs/${run.scan_id}/evaluation/simulation`, label = () => run.label
    if (!report.trials) return void (fill(body), say(told, 'No trial of this run has a simulated twin yet.'))
    const flagged = report.flagged ? `, ${count(report.flagged)} more excluded for a flag` : ''
    say(told, `${counted(report.trials, 'trial')} with a twin${flagged}. ${FVU_WORDS}`)
    const numbers = facts([['Median FVU', fixed(report.median_fvu, 3)], ['Median RMSE', about((report.median_rmse_v ?? NaN) * 1e3, 'mV')],
      ['Deadband', report.deadband_n == null ? 'not found' : fixed(report.deadband_n, 0, 'N')],
      ...report.contact_counts.slice(1).map((n, i) => [counted(i + 1, 'contact'), `${count(n)} (${percent(n, report.trials)})`])])
    const fvu = boxes({ title: `FVU by number of contacts, without the deadband (Fig. 7F; dashed: the paper, about ${paper.simulation_fvu})`, paper: paper.simulation_fvu, label, query,
      signal })
    const rmse = boxes({ title: 'RMSE by number of contacts (Fig. 7C)', unit: 'mV', factor: 1e3, label, query, signal })
    const of = key => report.by_contacts.map(one => ({ name: NUMERALS[one.contacts], trials: one.trials, ...one[key] }))
    const sample = el('div', { className: report.by_point.length ? 'column' : 'columns two' })
    const pairs = chart({ title: `FVU by pair of electrodes, newest ${counted(report.pair_trials, 'trial')} with contacts`, key: 'electrodes', whole: true,
      x: 'First electrode of the pair', time: false, series: [{ name: 'FVU', bars: true, fill: true, digits: 3 }], range: (_, high) => [0, Math.max(0.1, high * 1.1)],
      height: 200, label, query, signal })
    if (report.by_pair.length) fill(sample, pane(pairs.node))
    fill(body, panel('In short', {}, numbers), el('div', { className: 'columns two' }, pane(fvu.node), pane(rmse.node)),
      el('div', { className: 'columns two' }, pane(byForce(report, 'mean_fvu',
        { title: 'Mean FVU by largest force, up to 1.2 (Fig. 7E)', range: [0, 1.2], label, query, signal })),
        pane(byForce(report, 'mean_rmse_v', { title: 'Mean RMSE by largest force (Fig. 7B)', unit: 'mV', factor: 1e3, label, query, signal }))),
      report.by_point.length ? el('div', { className: 'columns wide-left' }, pane(...heat(run, report, { label, query, signal })), sample)
        : [panel('Mean FVU by place (Fig. 7D)', {}, el('p', { className: 'soft' }, 'No trial with a single tip above the deadband.')), sample])
    fvu.set(of('fvu'))
    rmse.set(of('rmse_v'))
    pairs.set([report.by_pair.map(pair => pair.electrodes[0]), report.by_pair.map(pair => pair.fvu)])
    await compare(run, sample, label)
  }

  /** Measured against simulated voltages of the newest trials with contacts. */
  async function compare(run, into, label) {
    const query = { scan_id__eq: run.scan_id, contact_count__gte: 1, flagged: false, limit: SAMPLE, sort: '-trial_id', voltages: true }
    const trials = (await get('/trials', query, { signal, wait: 30_000 })).items.filter(trial => trial.sim_voltages_v && trial.voltages_v)
    if (!trials.length) return
    const title = `Measured against simulated voltage, newest ${counted(trials.length, 'trial')} with contacts`
    const dots = scatter({ title, key: 'voltages', label, query: withQuery('/api/v1/trials', query), signal })
    into.prepend(pane(dots.node))
    dots.set(trials.flatMap(trial => trial.voltages_v.map((v, i) => [v, trial.sim_voltages_v[i]])))
  }
  return { node, show }
}

/** Makes a chart of simulated over measured voltages, mV, with the line on which both are the same: `set([[measured, simulated], …])`. */
export function scatter({ title, key, label, signal, query }) {
  const made = chart({ title, key, x: 'Measured', xUnit: 'mV', y: 'Simulated', unit: 'mV', time: false, height: 300, label, query, signal,
    series: [{ name: 'Simulated', line: false, points: true, digits: 2 }, { name: 'the same', dash: [5, 4], colour: '--soft', digits: 2 }] })
  return { node: made.node, set(pairs) {
    const step = Math.max(1, Math.ceil(pairs.length / DOTS)),
      kept = pairs.filter(([a, b], i) => a != null && b != null && i % step === 0).sort((a, b) => a[0] - b[0]), x = kept.map(([a]) => a * 1e3)
    made.set([x, kept.map(([, b]) => b * 1e3), x])
  } }
}

function byForce(report, key, { title, unit = '', factor = 1, range, label, query, signal }) {
  const groups = [null, 1, 2, 3, 4, 5, 6].filter(n => report.by_force.some(bin => bin.contacts === n))
  const forces = [...new Set(report.by_force.map(bin => bin.from_n))].sort((a, b) => a - b)
  const made = chart({ title, key: key.replaceAll('_', '-'), x: 'Largest force', xUnit: 'N', y: key === 'mean_fvu' ? 'FVU' : 'RMSE', unit, time: false, height: 230, range, label, query,
    signal,
    series: groups.map(n => ({ name: n == null ? 'all' : NUMERALS[n], digits: unit ? 2 : 3, gaps: true, points: true,
      ...(n == null ? { colour: '--ink' } : { colour: `--c${n}`, line: false }) })) })
  made.set([forces.map(f => f + 0.5), ...groups.map(n => forces.map(f => { const bin = report.by_force.find(bin => bin.from_n === f && bin.contacts === n);
    return bin ? bin[key] * factor : null }))])
  return made.node
}

function heat(run, report, { label, query, signal }) {
  const TOP = 0.5, spots = () => report.by_point.map(p => [p.x_mm, p.y_mm])
  const view = skin({ title: `Mean FVU by place, one tip above the deadband (Fig. 7D)`, label, query, signal,
    describe: () => `Skin with the mean FVU at ${counted(report.by_point.length, 'place')}`,
    data: () => ({ heads: ['x_mm', 'y_mm', 'trials', 'mean_fvu'], rows: report.by_point.map(p => [p.x_mm, p.y_mm, p.trials, p.mean_fvu]) }),
    spots,
    onhover(mm) {
      const p = mm && report.by_point[nearest(spots(), mm, 20)]
      return p ? `x ${fixed(p.x_mm, 0)}, y ${fixed(p.y_mm, 0, 'mm')}: mean FVU ${fixed(p.mean_fvu, 3)} of ${counted(p.trials, 'trial')}` : ''
    },
    draw(pen, scale, shape) {
      const colours = sequential()
      for (const p of report.by_point) {
        const fill = `rgb(${colours[Math.round(254 * Math.min(1, p.mean_fvu / TOP))]})`
        tips(pen, scale, [[p.x_mm, p.y_mm]], shape.tip_diameter_mm, { fill, stroke: scale.colour('--grey'), width: 1 })
      }
    } })
  sensorOf(run.scan_id).then(view.geometry, () => {})
  const scale = scaleBar('mean FVU', signal)
  scale.ticks(['0', '0.125', '0.25', '0.375', `${TOP} and more`])
  return [view.node, scale.node]
}
