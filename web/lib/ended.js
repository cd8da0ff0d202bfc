// What became of the last run, and what may follow: its summary, links to its data, the next run of the queue.

import { get } from './api.js'
import { beginButton } from './begin.js'
import { el, facts, fill, link, renew, say } from './dom.js'
import { NONE, about, capital, count, counted, fixed, moment, span } from './format.js'
import { endWord, largest } from './runwords.js'
import { meaning } from './vocabulary.js'
import { TONE } from './words.js'

/** When a queued run begins. */
function startWords({ waiting_since, not_before }) {
  if (waiting_since) return 'It is started and begins when the rig is free.'
  if (not_before && Date.parse(not_before) > Date.now()) return `It must be armed and started; it begins at ${moment(not_before)} at the earliest.`
  return 'It must be armed and started.'
}

const NEXT = n => [[`/runs?run=${n}`, 'Read its report'], [`/trials?run=${n}`, 'Look through its trials'], ['/data', 'Make a dataset'],
  [`/model?run=${n}`, 'Compare with the simulation'], ['/queue', 'Queue another run']]

/** Makes the summary of a run that is not active: `show(run, progress)`, `next(queued)`. `said` tells what came of actions. */
export function ended({ said, signal }) {
  const head = el('p', { className: 'state' }), why = el('p'), list = el('div'), links = el('div'), begin = el('div'), queued = el('div')
  const node = el('div', {}, head, why, begin, list, links, queued)
  let shown = ''
  return {
    node,
    async show(run, progress) {
      const over = run.exit_status != null, isOther = () => shown !== run.uid
      shown = run.uid
      head.textContent = capital(over ? endWord(run) : 'interrupted')
      head.className = `state ${over ? run.exit_status === 'success' ? '' : TONE[run.exit_status] ?? '' : 'warn'}`
      fill(why, `Run ${run.scan_id}, ${run.experiment}${run.ended_at ? `, ${moment(run.ended_at)}` : ''}: `,
        over ? `${run.reason ?? run.exit_status}.` : `it waits: ${meaning('pauses', run.paused_why) || 'it was interrupted'}. Its trials are stored, and it can resume.`)
      fill(begin, run.is_resumable && el('div', { className: 'row' }, beginButton('Arm and resume', run, said, { className: 'main' })))
      try {
        const summary = await get(`/runs/${run.uid}/summary`, {}, { signal }), fvu = el('span', {}, NONE)
        if (isOther()) return
        fill(list, facts([
          ['Trials stored', `${count(summary.trials_stored)} of ${count(run.trials_planned)}`], ['Skipped', counted(summary.trials_skipped, 'trial')],
            ['Failed attempts', count(summary.retries)],
          ['Duration', span(summary.duration_s)], ['Largest force', fixed(largest(progress?.largest_force_n), 1, 'N')], ['Median FVU', fvu],
        ]))
        get(`/runs/${run.uid}/evaluation/simulation`, {}, { signal, wait: 20_000 }).then(fit => say(fvu, about(fit.median_fvu)), () => {})
      } catch (error) { if (!signal.aborted && !isOther()) fill(list, el('p', { className: 'soft' }, `Its summary could not be read: ${error.message}`)) }
      if (isOther()) return
      const n = run.scan_id
      fill(links, el('h3', {}, 'What next'), el('p', { className: 'next-links' }, NEXT(n).map(([href, words]) => link(href, words))))
    },
    next(first) {
      const waits = first && startWords(first)
      renew(queued, [first, waits], () => first && [el('h3', {}, 'Next in the queue'), el('p', {},
        `Run ${first.scan_id}, ${first.experiment}, ${counted(first.trials_planned, 'trial')}. ${waits}`),
        el('div', { className: 'row' }, !first.waiting_since && beginButton('Arm and start', first, said, { className: 'main' }),
          link(`/plan?run=${first.scan_id}`, 'Its plan'))])
    },
  }
}
