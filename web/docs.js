// The description of the API: Swagger UI, with the key of this tab. It sends GET requests only: nothing moves from here.
import { keep } from './lib/api.js'

// Its dark style is a class of the root.
const dark = matchMedia('(prefers-color-scheme: dark)'), colour = () => document.documentElement.classList.toggle('dark-mode', dark.matches)
dark.addEventListener('change', colour)
colour()

window.SwaggerUIBundle({
  url: '/openapi.json', dom_id: '#docs', deepLinking: true, docExpansion: 'none', validatorUrl: null, defaultModelsExpandDepth: 0, filter: true, supportedSubmitMethods: ['get'],
  requestInterceptor(request) {
    const key = keep('sessionStorage', 'palpate-key')
    if (key) request.headers.authorization = `Bearer ${key}`
    return request
  },
})
