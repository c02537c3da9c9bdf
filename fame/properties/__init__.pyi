from fame.properties.files import read_properties as read_properties
from fame.properties.grammar import parse as parse
from fame.properties.judge import Judge as Judge
from fame.properties.judgement import Judgement as Judgement
from fame.properties.monitor import Monitor as Monitor, compile as compile
from fame.properties.parts import Verdict as Verdict
from fame.properties.sentence import Location as Location, Property as Property
from fame.properties.vocabulary import Vocabulary as Vocabulary, vocabulary_of as vocabulary_of
