// The random draw of a slot under the keys of a step (`draw` of pearl_marl/rng.py): one a cycle,
// DRAW_LATENCY cycles after its slot number.
module pearl_draw
  import pearl_pkg::*;
(
    input  logic        clk_i,
    input  logic [31:0] slot_i,
    input  logic [31:0] key_a_i,
    input  logic [31:0] key_b_i,
    output logic [31:0] draw_o
);

  logic [31:0] first_q, second_q, draw_q;

  always_ff @(posedge clk_i) begin
    first_q  <= mix_first(slot_i ^ key_a_i);
    second_q <= mix_second(first_q ^ key_b_i);
    draw_q   <= mix_last(second_q);
  end

  assign draw_o = draw_q;

endmodule
