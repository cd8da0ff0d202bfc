// Night: is it safe, is it on time, are the data good? One screen for the active run, or for the last one.
// Uses the parts in lib/. Its address: colour, configuration, frame, scale, minutes, night, from, to, event, log.

import { outcome, runButtons } from '../lib/actions.js'
import { get } from '../lib/api.js'
import { changing } from '../lib/changing.js'
import { dataView } from '../lib/dataview.js'
import { el, every, fill, panel, pane, say, select } from '../lib/dom.js'
import { ended } from '../lib/ended.js'
import { steadyEnds } from '../lib/eta.js'
import { forceBars, forceChart } from '../lib/forces.js'
import { age, bytes, capital, count, countOf, counted, fixed, moment, momentBand, percent, plain, span, steadyCountOf } from '../lib/format.js'
import { history } from '../lib/history.js'
import { live } from '../lib/live.js'
import { eventLog } from '../lib/log.js'
import { BEGUN, motionWords, stateWords, withMotion } from '../lib/runwords.js'
import { sensorOf } from '../lib/skin.js'
import { COLOURINGS, tourMap } from '../lib/tourmap.js'
import { backlog } from '../lib/twinpool.js'
import { meaning } from '../lib/vocabulary.js'
import { watching } from '../lib/watching.js'
import { welcome } from '../lib/welcome.js'
import { TONE } from '../lib/words.js'

const QUESTIONS = [['safe', 'Is it safe?'], ['on_time', 'Is it on time?'], ['data', 'Are the data good?']]
const MINUTES = [['1', '1 min'], ['', '2 min'], ['5', '5 min'], ['15', '15 min']]
const TWINS_MS = 5000, QUEUE_MS = 10_000, HISTORY_MS = 30_000, PROGRESS_MS = 3000, LONG_TOUR = 5000

const SAYS = {
  idle: 'It is about to begin.', pausing: 'It ends the present trial, raises the tips, then waits.',
    stopping: 'It ends the present trial, raises the tips, then ends.',
  aborting: 'The tips are raised now; then it ends.', suspending: 'It was suspended: the tips are raised.',
    panicked: 'The tips could not be raised. Check the rig, then reset.',
}
const WAITS = ['tips', 'weights', 'resume'] // Needs of a run.

/** What a run does, as one sentence. */
function doingWords(run, needs) {
  if (run.state === 'running') return `It is ${meaning('phases', run.phase) || plain(run.phase)}.`
  if (run.state === 'paused') return needs.find(need => WAITS.includes(need.kind))?.words ?? ''
  return SAYS[run.state] ?? ''
}

/** The end of a run that continues, as a person's clock shows it. */
function endWords(run, at) {
  return run?.eta && ['running', 'pausing'].includes(run.state) ? `Done about ${momentBand(...steadyEnds(run, at), run.eta.high_s < 900)}. ` : ''
}

/** Shows the page. */
export async function show(root, { query, signal, set }) {
  let state = query, run = null, last = null, tour = null, progress = null, shape = null, twins = null, queue = [], seen = {}, mode = ''
  const label = () => (run ?? last)?.label ?? live.status?.rig.label
  const said = outcome()

  // Parts.
  const answers = QUESTIONS.map(([question, title]) => ({ question, title, node: el('p', { className: 'answer' }) }))
  const strip = el('div'), verdicts = el('section', { className: 'verdicts live', 'aria-label': 'The night in three answers' },
    answers.map(({ title, node }) => el('div', {}, el('h2', {}, title), node)), strip)
  const map = tourMap({
    signal, label, query: () => `/api/v1/runs/${(run ?? last)?.scan_id}/progress`, href: n => `/trials?run=${(run ?? last)?.scan_id}&configuration=${n}`,
    onselect: i => set({ configuration: i == null ? null : tour.steps.configuration[i] }), forceLimit: () => live.status?.rig.force_limit_n ?? null,
  })
  const colours = select(COLOURINGS, state.colour ?? 'progress', value => set({ colour: value === 'progress' ? null : value }),
    { 'aria-label': 'What the colours show' })
  const skinWords = el('p', { className: 'soft small' }), skinPart = pane(map.node, skinWords)
  map.beside(colours)
  skinPart.classList.add('live', 'tour')

  const headline = el('p', { className: 'state' }), why = el('p', { className: 'why' }), step = el('p', { className: 'soft' })
  const bar = el('progress', { 'aria-label': 'Trials stored' }), runFacts = el('div')
  const buttons = runButtons(said), active = el('div', {}, el('div', { className: 'headline' }, headline, why), bar, step, runFacts, buttons.node)
  const over = ended({ said, signal }), nowBody = el('div')
  const low = innerWidth >= 1240 && innerHeight < 1200 // A wall shows all without scrolling.
  const bars = forceBars({ signal }), chart = forceChart({ signal, label, height: low ? 118 : 150, minutes: Number(state.minutes) || 2 })
  const minutes = select(MINUTES, state.minutes ?? '', value => set({ minutes: value }), { 'aria-label': 'Time that the chart shows' })
  const nowPart = panel('Now', { className: 'live now', aside: minutes }, nowBody, said.node, bars, chart.node)

  const data = dataView({ state, set, signal, label, onfacts: more => { seen = { ...seen, ...more }; tellData() } })
  const dataFacts = el('div'), watch = watching(), dataPart = panel('Data', { className: 'live data', aside: data.controls }, data.node, dataFacts, watch.node)
  const nightPart = history({ state, set, signal, label, height: low ? 94 : 170 })
  const log = eventLog({ state, set, signal })
  const hello = welcome({ said: outcome() }), beginning = el('div', { className: 'columns two' }, dataPart, log.node)

  function arrange() {
    const next = run || last ? 'run' : 'welcome'
    if (mode === next) return
    mode = next
    if (mode === 'welcome') fill(root, hello.node, beginning)
    else {
      fill(root, verdicts, el('div', { className: 'columns night-top' }, skinPart, nowPart, dataPart),
        el('div', { className: 'columns night-foot' }, nightPart.node, log.node))
    }
  }

  // What follows the status: at most ten times per second, text only where it differs.
  function tell({ status, at, fresh }) {
    if (status.run?.uid !== run?.uid || (!status.run && run)) change()
    for (const { question, node } of answers) {
      const { rating, words } = status.glance.find(one => one.question === question)
      say(node, question === 'on_time' ? endWords(status.run, at) + words : words)
      node.className = `answer ${rating}`
    }
    tellStrip(status)
    watch.show(status.suspenders)
    if (status.run) tellRun(status.run, status.needs, fresh)
    buttons.show(live)
    if (mode === 'welcome') hello.show(queue[0] ?? null)
    beginning.hidden = status.rig.state === 'disconnected' // Nothing comes yet.
  }

  function tellStrip({ run, disk, last_trial_at, lock, queue_length, waiting_for, not_begun, rig }) {
    const next = waiting_for && waiting_for !== not_begun ? `: ${waiting_for}` : ''
    const trialAt = last_trial_at ?? seen.trial?.measured_at
    changing(strip, [
      ['Last trial stored', trialAt ? `${span(age(trialAt))} ago` : 'none yet'],
      ['Disk', disk ? `${bytes(disk.free_bytes)} free, ${bytes(disk.needed_bytes)} needed` : 'not reported'],
      ['Queue', queue_length ? counted(queue_length, 'run') + next : 'empty'],
      ['Operator lock', lock ? `${lock.holder}, since ${moment(lock.since)}: ${lock.note}` : 'free'],
      !run && ['Rig', motionWords(live.motion) || meaning('rig_states', rig.state) || `${capital(plain(rig.state))}.`],
    ])
  }

  function tellRun(now, needs, fresh) {
    say(headline, withMotion(stateWords(now), live.motion))
    headline.className = `state ${TONE[now.state] ?? ''}`
    say(why, doingWords(now, needs))
    const index = now.current_step?.index ?? progress?.current, of = now.current_step?.of ?? tour?.steps.configuration.length
    const depth = now.trial && tour?.depths_mm[now.trial.depth_index]
    const thing = tour?.kind === 'real-random' ? 'Placement' : 'Configuration'
    const where = index != null && of ? `${thing} ${countOf(index + 1, of)}`
      : now.trial ? `${thing} ${count(now.trial.configuration)}` : 'Between configurations'
    const deep = depth == null || !now.trial ? '' : `, depth ${now.trial.depth_index + 1} of ${tour.depths_mm.length}: ${fixed(depth, 1, 'mm')}`
    say(step, where + deep)
    bar.max = now.trials_planned || 1
    bar.value = now.trials_stored
    map.now(now.current_step?.index ?? null)
    changing(runFacts, [
      ['Stored', steadyCountOf(now.trials_stored, now.trials_planned)], ['Share', percent(now.trials_stored, now.trials_planned)],
      ['Skipped', counted(now.trials_skipped, 'trial')], ['Failed attempts', count(now.retries)],
    ])
    active.inert = !fresh
  }

  function tellData() {
    const rolling = twins?.pool.rolling, limit = live.status?.suspenders?.find(one => one.name === 'twin_fvu' && one.suspends)
    const broken = seen.stuck ? `${seen.stuck.length} stuck, ${seen.saturated?.length ?? 0} saturated` : 'not reported'
    const unread = twins ? null : 'not read yet'
    changing(dataFacts, [
      ['Rolling FVU', rolling ? `${fixed(rolling.median_fvu, 3)}${limit ? ` of ${fixed(limit.threshold, 2)}` : ''}` : unread ?? 'none yet'],
      ['Twins', backlog(twins, (run ?? last)?.uid) ?? unread ?? 'none'], ['Channels', broken],
    ])
  }

  // What is asked for: the run's tour once, its progress while trials are stored, its course each half minute.
  let changes = 0, isOld = true // Whether the runs are still to be read since the last change.
  async function change() {
    isOld = true
    const mine = changes += 1, left = () => signal.aborted || mine !== changes
    run = live.status?.run ?? null
    try {
      const found = run ? await get(`/runs/${run.uid}`, {}, { signal }) : (await get('/runs', { ...BEGUN, limit: 1 }, { signal })).items[0] ?? null
      if (left()) return
      last = found
    } catch (error) {
      if (!mode && !left()) fill(root, pane(el('p', { className: 'bad' }, `The runs could not be read: ${error.message}. Trying again.`)))
      return
    }
    isOld = false
    arrange()
    const of = run ?? last
    fill(nowBody, run ? active : last ? over.node : '')
    nowPart.classList.toggle('over', !run)
    say(nowPart.querySelector('h2 > span'), run ? 'Now' : 'The last run')
    if (!of) return void hello.show(queue[0] ?? null)
    tour = progress = null
    data.run(of.uid)
    readCourse() // That of a long run takes minutes: nothing waits for it.
    await Promise.allSettled([readTour(of), readShape(of)])
    if (left()) return
    if (!tour) map.set(null, null, shape, !run)
    await readProgress()
    if (left()) return
    if (!run && last) { over.show(last, progress); over.next(queue[0]) }
  }
  async function readTour(of) {
    try {
      const read = await get(`/runs/${of.scan_id}/tour`, {}, { signal, wait: 20_000 })
      if (of.uid !== (run ?? last)?.uid) return
      tour = read
      say(skinWords, '')
    } catch (error) { if (of.uid === (run ?? last)?.uid) say(skinWords, `There is no tour to draw: ${error.message}.`) }
  }
  async function readShape(of) {
    const read = await sensorOf(of.scan_id).catch(() => null)
    if (of.uid === (run ?? last)?.uid) shape = read
  }
  let storedThen = -1
  async function readProgress() {
    const of = run ?? last
    if (!of || !tour) return
    const stored = live.status?.run?.trials_stored ?? -1 // What is stored while this is read may be missing in it.
    try {
      const read = await get(`/runs/${of.scan_id}/progress`, {}, { signal, wait: 20_000 })
      if (of.uid !== (run ?? last)?.uid) return
      progress = read
      storedThen = stored
    } catch (error) { if (!signal.aborted && of.uid === (run ?? last)?.uid) say(skinWords, `The progress could not be read: ${error.message}`) }
    if (signal.aborted || !tour || of.uid !== (run ?? last)?.uid) return
    map.set(tour, progress, shape, !run)
    choose()
  }
  /** Marks the configuration of the address. */
  function choose() {
    const chosen = state.configuration == null || !tour ? -1 : tour.steps.configuration.indexOf(Number(state.configuration))
    map.choose(chosen < 0 ? null : chosen)
  }
  let reading = ''
  async function readCourse() {
    const of = run ?? last
    const key = `${of?.uid} ${run ? '' : last?.ended_at}` // The end of a run is read again at once.
    if (!of || reading === key) return
    reading = key
    await nightPart.show(of, { endedAt: !run && last?.ended_at ? Date.parse(last.ended_at) : null, eta_s: live.status?.run?.eta?.remaining_s ?? null })
    if (reading === key) reading = ''
  }

  map.colouring(state.colour ?? 'progress')
  live.on('status', tell, signal)
  for (const kind of ['fresh', 'caller']) live.addEventListener(kind, () => live.status && tell(live), { signal })
  every(TWINS_MS, async () => { try { twins = await get('/twins', {}, { signal }); tellData() } catch { /* Old values keep their age. */ } }, signal)
  every(QUEUE_MS, async () => {
    try { queue = (await get('/queue', {}, { signal })).items } catch { return }
    if (isOld) await change()
    if (!run && last) over.next(queue[0])
    if (mode === 'welcome') hello.show(queue[0] ?? null)
  }, signal)
  every(() => (tour?.steps.configuration.length ?? 0) > LONG_TOUR ? 10 * PROGRESS_MS : PROGRESS_MS,
    async () => {
      if (!run || live.status?.run?.trials_stored === storedThen) return
      // What could not be read at first is read again.
      if (!tour) await readTour(run)
      if (!shape) await readShape(run)
      await readProgress()
    }, signal)
  every(HISTORY_MS, async () => { if (run) await readCourse() }, signal)
  await change()

  return {
    update(next) {
      state = next
      colours.value = state.colour ?? 'progress'
      map.colouring(colours.value)
      minutes.value = state.minutes ?? ''
      chart.minutes(Number(state.minutes) || 2)
      for (const part of [data, nightPart, log]) part.update(state)
      choose()
    },
  }
}
