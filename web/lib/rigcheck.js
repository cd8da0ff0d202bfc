// The report of a rig check as tables: problems first, then what each device answered.

import { el } from './dom.js'
import { NONE, about, count, fixed, listed, plain } from './format.js'
import { table } from './table.js'

const ARMS = [0, 1, 2, 3, 4, 5]
const us = v => about(v, 'µs')

/** Makes the report. */
export function checkReport(report) {
  const { problems, unchecked = [], axes, cells, stream, lines = [] } = report
  const counters = Object.keys(lines[0]?.counts ?? {}).filter(key => typeof lines[0].counts[key] === 'number')
  const list = (words, tone) => el('ul', { className: `${tone} listed` }, words.map(text => el('li', {}, text)))
  const part = (title, ...inside) => el('div', {}, el('h3', {}, title), inside)
  return el('div', { className: 'report' },
    el('p', { className: problems.length ? 'bad big' : 'good big' }, problems.length
      ? `${problems.length === 1 ? 'One problem' : `${problems.length} problems`}` : 'No problem found.'),
    problems.length ? list(problems, 'bad') : '', unchecked.length ? [el('p', { className: 'soft' }, 'Not checked in this state:'), list(unchecked, 'soft')]
      : '',
    axes?.length > 0 && part('Axes', table({ rows: axes,
      columns: [{ head: 'Axis', cell: a => a.name }, { head: 'Device', left: true, cell: a => a.identity ?? 'no answer' },
      { head: 'Position', cell: a => fixed(a.position, 3, a.unit) }, { head: 'Homed', cell: a => a.homed == null ? NONE : a.homed ? 'yes' : 'no' },
      { head: 'Alarm', cell: a => a.alarm == null ? 'none' : a.alarm.toString(16).toUpperCase() },
        { head: 'Status request', cell: a => a.status_us == null ? NONE : `${us(a.status_us)}, at most ${us(a.status_us_max)}` }] }).node),
    cells && part('Load cells', el('p', { className: 'soft' },
      listed([cells.identity ?? 'no answer', cells.live == null ? '' : `${cells.live} of 6 connected`, cells.read_us == null ? ''
      : `a reading takes ${us(cells.read_us)}`])),
      table({ rows: ARMS, columns: [{ head: 'Arm', cell: i => String(i + 1) }, { head: 'Output', unit: 'V', cell: i => fixed(cells.volts?.[i], 4) },
        { head: 'Force above nominal zero', unit: 'N', cell: i => fixed(cells.force_n?.[i], 2) },
        { head: 'Noise, 1 sd', unit: 'N', cell: i => fixed(cells.noise_n?.[i], 3) }] }).node),
    stream && part('Voltage stream', table({ rows: [['Status line', stream.status_line ?? 'no answer'], ['Frames evaluated', count(stream.frames)],
      ['Frame rate', about(stream.frame_rate_hz, 'Hz')], ['Device seconds per second', about(stream.device_rate)], ['Missed', count(stream.missed)],
      ['Garbled', count(stream.garbled)],
      ['Signal, sd over the channels', about((stream.frame_sd_v ?? NaN) * 1e3, 'mV')],
        ['Noise, sd of a channel', about((stream.noise_sd_v ?? NaN) * 1e3, 'mV')], ['Signal to noise', about(stream.signal_to_noise)],
        ['Largest injection sum', about((stream.injection_sum_v ?? NaN) * 1e3, 'mV')], ['Saturated channels', count(stream.saturated_channels)]],
    columns: [{ head: 'Quantity', cell: row => row[0] }, { head: 'Found', cell: row => row[1] }] }).node),
    lines.length > 0 && part('Wires', table({ rows: lines,
      columns: [{ head: 'Wire', cell: l => l.name }, ...counters.map(key => ({ head: plain(key).replace(/ us$/, ', µs'),
        cell: l => count(l.counts[key]) }))] }).node))
}
