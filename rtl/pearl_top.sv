// SPDX-License-Identifier: MIT
// The whole design for a board: an AXI4 slave, as an XDMA core masters it, in front of the backbone,
// and an interrupt.
//
// Reset has to last as long as the backbone says, and to be released in step with the clock.
module pearl_top #(
    // Slots, processing elements and bits of a word of the address space.
    parameter int unsigned N_ENVS = 7,
    parameter int unsigned PE_NUM = 4,
    parameter int unsigned DATA_WL = 32,
    // Whether groups overlap. If not, one is read, computed and written after the other: the results
    // are the same, later.
    parameter bit PIPELINED = 1'b1,
    // Bits of a byte address on the bus; enough for the whole map.
    parameter int unsigned ADDR_BITS = 16,
    parameter int unsigned ID_BITS = 4,
    localparam int unsigned STRB_BITS = DATA_WL / 8
) (
    input  logic clk_i,
    input  logic rst_ni,
    // High from the end of a step to the next doorbell.
    output logic irq_o,

    input  logic [  ID_BITS-1:0] s_axi_awid,
    input  logic [ADDR_BITS-1:0] s_axi_awaddr,
    input  logic [          7:0] s_axi_awlen,
    input  logic [          2:0] s_axi_awsize,
    input  logic [          1:0] s_axi_awburst,
    input  logic                 s_axi_awvalid,
    output logic                 s_axi_awready,
    input  logic [  DATA_WL-1:0] s_axi_wdata,
    input  logic [STRB_BITS-1:0] s_axi_wstrb,
    input  logic                 s_axi_wlast,
    input  logic                 s_axi_wvalid,
    output logic                 s_axi_wready,
    output logic [  ID_BITS-1:0] s_axi_bid,
    output logic [          1:0] s_axi_bresp,
    output logic                 s_axi_bvalid,
    input  logic                 s_axi_bready,
    input  logic [  ID_BITS-1:0] s_axi_arid,
    input  logic [ADDR_BITS-1:0] s_axi_araddr,
    input  logic [          7:0] s_axi_arlen,
    input  logic [          2:0] s_axi_arsize,
    input  logic [          1:0] s_axi_arburst,
    input  logic                 s_axi_arvalid,
    output logic                 s_axi_arready,
    output logic [  ID_BITS-1:0] s_axi_rid,
    output logic [  DATA_WL-1:0] s_axi_rdata,
    output logic [          1:0] s_axi_rresp,
    output logic                 s_axi_rlast,
    output logic                 s_axi_rvalid,
    input  logic                 s_axi_rready
);

  localparam bit LEGAL_N_ENVS = N_ENVS >= 1;
  localparam bit LEGAL_PE_NUM = PE_NUM >= 1 && PE_NUM <= N_ENVS;
  localparam bit LEGAL_DATA_WL = DATA_WL >= 32 && DATA_WL <= 1024 && DATA_WL == 2 ** $clog2(DATA_WL);
  localparam bit LEGAL_ID_BITS = ID_BITS >= 1;

  // Below, an illegal value is replaced: a tool would stop at what follows from it, a negative width
  // or a division by zero, before it comes to the sentence that says why.
  localparam int unsigned SLOTS = LEGAL_N_ENVS ? N_ENVS : 1;
  localparam int unsigned PES = LEGAL_PE_NUM ? PE_NUM : 1;
  localparam int unsigned WORD_BITS = LEGAL_DATA_WL ? DATA_WL : 32;
  localparam int unsigned BUS_ID_BITS = LEGAL_ID_BITS ? ID_BITS : 1;

  localparam int unsigned BYTE_BITS = $clog2(WORD_BITS / 8);
  localparam int unsigned END_OFFSET = pearl_map_pkg::region_offset(
      pearl_pkg::NumRegions, SLOTS, PES, WORD_BITS
  );
  localparam int unsigned LEAST_ADDR_BITS = $clog2(END_OFFSET + 1) + BYTE_BITS;
  localparam int unsigned MOST_ADDR_BITS = 64;
  localparam bit LEGAL_ADDR_BITS = ADDR_BITS >= LEAST_ADDR_BITS && ADDR_BITS <= MOST_ADDR_BITS;
  localparam int unsigned BUS_ADDR_BITS = LEGAL_ADDR_BITS ? ADDR_BITS : LEAST_ADDR_BITS;
  localparam int unsigned WORD_ADDR_BITS = BUS_ADDR_BITS - BYTE_BITS;

  if (!LEGAL_N_ENVS) begin : gen_illegal_n_envs
    $error("N_ENVS is %0d; there must be at least 1 slot", N_ENVS);
  end
  if (!LEGAL_PE_NUM) begin : gen_illegal_pe_num
    $error("PE_NUM is %0d; possible are 1 to N_ENVS = %0d", PE_NUM, N_ENVS);
  end
  if (!LEGAL_DATA_WL) begin : gen_illegal_data_wl
    $error("DATA_WL is %0d; possible are the powers of two from 32 to 1024", DATA_WL);
  end
  if (!LEGAL_ID_BITS) begin : gen_illegal_id_bits
    $error("ID_BITS is %0d; there must be at least 1", ID_BITS);
  end
  if (!LEGAL_ADDR_BITS) begin : gen_illegal_addr_bits
    $error(
        "ADDR_BITS is %0d; possible are %0d, which reach the end of the map, to %0d",
        ADDR_BITS,
        LEAST_ADDR_BITS,
        MOST_ADDR_BITS
    );
  end
  logic req, we, fetch, rvalid;
  logic [WORD_ADDR_BITS-1:0] addr;
  logic [WORD_BITS-1:0] wdata, rdata;
  pearl_pkg::resp_e resp;

  pearl_axi_slave #(
      .DATA_WL  (WORD_BITS),
      .ADDR_BITS(BUS_ADDR_BITS),
      .ID_BITS  (BUS_ID_BITS)
  ) u_axi_slave (
      .req_o   (req),
      .we_o    (we),
      .fetch_o (fetch),
      .addr_o  (addr),
      .wdata_o (wdata),
      .rvalid_i(rvalid),
      .rdata_i (rdata),
      .resp_i  (resp),
      // Clock, reset and the bus, which have the same names here.
      .*
  );

  pearl_backbone #(
      .N_ENVS(SLOTS),
      .PE_NUM(PES),
      .DATA_WL(WORD_BITS),
      .PIPELINED(PIPELINED),
      .WORD_ADDR_BITS(WORD_ADDR_BITS)
  ) u_backbone (
      .clk_i,
      .rst_ni,
      .irq_o,
      .req_i   (req),
      .we_i    (we),
      .fetch_i (fetch),
      .addr_i  (addr),
      .wdata_i (wdata),
      .rvalid_o(rvalid),
      .rdata_o (rdata),
      .resp_o  (resp)
  );

endmodule
